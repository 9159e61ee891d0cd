"""Pictures of maps: values, confidence, bounds."""

from dataclasses import replace

import numpy as np
import pytest

from depthcli.show.view import NO_VALUE, UNKNOWN, View, bound_range, draw, draw_legend, map_colors


def confidence(values: np.ndarray) -> np.ndarray:
    return draw(View(values), "confidence")


def test_confidence_is_spread_robustly():
    values = np.linspace(-2, 3, 1000, dtype=np.float32).reshape(20, 50)
    values[0, 0], values[0, 1], values[0, 2] = np.nan, np.inf, -np.inf
    picture = confidence(values)
    assert picture[0, 0] == 0 and picture[0, 1] == 255 and picture[0, 2] == 0
    assert picture[10, 0] in (127, 128)
    assert np.all(np.diff(picture.ravel()[3:].astype(int)) >= 0)
    assert confidence(np.full((2, 2), 7.0)).tolist() == [[255, 255]] * 2
    assert confidence(np.full((2, 2), np.nan)).tolist() == [[0, 0]] * 2
    for absent in ("status", "bound", "error", "sharpness"):
        with pytest.raises(ValueError, match=absent):
            draw(View(values), absent)


def test_previews():
    near, far = draw(View.of_depth(np.array([[1, 2, 4, np.nan, 0]], np.float32)), "preview")[0, [0, 2]].astype(int)
    assert near[0] > near[2] and far[2] > far[0]
    assert draw(View.of_depth(np.full((1, 2), np.nan, np.float32)), "preview").max() == 0
    picture = draw(View(np.array([[0, 5, 10, np.nan]], np.float32), scale=(0, 10)), "preview")
    assert picture.dtype == np.uint8 and picture.shape == (1, 4, 3)
    assert picture[0, 3].tolist() == [0, 0, 0]
    assert len({tuple(color) for color in picture[0].tolist()}) == 4


def test_the_image_shows_where_an_error_is_unknown():
    kinds, image = np.array([[UNKNOWN, *set(range(3)) - {UNKNOWN}]], np.uint8), np.full((1, 3, 3), 200, np.uint8)
    view = View(np.zeros((1, 3), np.float32), kinds=kinds, error=np.zeros((1, 3), np.float32), image=image, opacity=0.5)
    alone = draw(replace(view, image=None), "error")[0].astype(int)
    over = draw(view, "error")[0].astype(int)
    assert over[0].tolist() == [200] * 3 and np.abs(over[1:] - (alone[1:] + 200) / 2).max() <= 1


def test_depth_lies_over_a_scale_in_meters():
    depth = np.linspace(1, 4, 200, dtype=np.float32)[None].repeat(20, axis=0)
    picture = draw(View.of_depth(depth), "preview")
    assert picture.shape == (20 + 3 * 20, 200, 3)
    bar = picture[20 + 20 + 4].astype(int)
    assert bar[0, 2] > bar[0, 0] and bar[-1, 0] > bar[-1, 2]  # far is blue, on the left, near red
    assert (picture[20:40].min(axis=2) < 128).any() and (picture[60:].min(axis=2) < 128).any()  # title and numbers
    both = draw(View.of_depth(depth, np.full(depth.shape, 0.1, np.float32)), "preview")
    np.testing.assert_array_equal(both[:, :200], picture)


def test_a_legend_names_its_colors():
    picture = draw_legend([("right", (0, 0, 255)), ("wrong", (255, 0, 0))])
    assert picture.shape[0] == 2 * 20 + 16
    assert picture[8 + 10, 12].tolist() == [0, 0, 255] and picture[8 + 30, 12].tolist() == [255, 0, 0]


def test_bounds_lie_beside_their_map_over_a_bar_of_their_colors():
    shown = np.full((30, 200), np.nan, np.float32)
    bound = np.geomspace(0.1, 10, shown.size).reshape(shown.shape)
    bound[0, 0], bound[0, 1], bound[0, 2] = np.nan, np.inf, 0
    picture = draw(View(shown, "px", bound=bound), "preview")
    assert (picture[:30, :200] == 0).all() and picture[:30, 208:].any()
    assert [tuple(picture[0, 208 + x]) for x in range(3)] == [NO_VALUE, *map(tuple, map_colors()[[-1, 0]])]
    bar = [row for row in picture[30:, 208:] if np.array_equal(row[[0, -1]], map_colors()[[0, -1]])]
    assert len(bar) > 8
    low, high = bound_range(bound)
    assert 0.1 <= low < 0.2 and 8 < high <= 10
    for unusual in ([np.nan, np.nan], [np.inf, 0], [3, 3]):
        assert 0 < bound_range(np.array(unusual))[0] < bound_range(np.array(unusual))[1]
        assert draw(View(shown[:1, :2], "m", bound=np.array([unusual])), "preview").shape[1:] == (12, 3)
