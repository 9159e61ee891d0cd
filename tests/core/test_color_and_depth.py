"""Depth maps in the color camera's pixels: exact on surfaces, steps and gaps stay, near surfaces hide far ones."""

import numpy as np
import pytest

from depthcli.core.cameras.camera import Camera, Intrinsics
from depthcli.core.cameras.color_and_depth import ColorAndDepth, Place, draw_quads, registered
from depthcli.core.errors import InputError
from tests.golden import refused
from tests.naive.quads import draw_quads as naive_quads
from tests.rendered import COLOR, COLOR_SHAPE, DEPTH, DEPTH_SHAPE, ROTATION, TRANSLATION, near_edges, noisy, rendered

PLACE: Place = (tuple(ROTATION.ravel().tolist()), tuple(TRANSLATION.tolist()))
TRUTH, PLANE = rendered(COLOR, COLOR_SHAPE)
SENSED, SENSED_PLANE = rendered(DEPTH, DEPTH_SHAPE, ROTATION, TRANSLATION)
# Away from the image's border, which the depth camera does not see everywhere, and from depth edges.
INSIDE = np.zeros(COLOR_SHAPE, bool)
INSIDE[40:-40, 50:-50] = True
SURFACES = INSIDE & ~near_edges(PLANE, 16)


def registered_room(depth):
    return registered(depth.astype(np.float32), COLOR_SHAPE, COLOR, DEPTH, PLACE)


@pytest.mark.parametrize("seed", range(4))
def test_quads_are_drawn_as_by_the_plain_loop(seed: int):
    rng = np.random.Generator(np.random.PCG64(seed))
    corners = rng.integers(-2, 20, (6, 2, 1)) + np.array([[0, 7, 7, 0], [0, 0, 5, 5]])
    x, y = corners[:, 0] + rng.uniform(-2, 2, (6, 4)), corners[:, 1] + rng.uniform(-2, 2, (6, 4))
    x[0], y[0] = x[0].round(), y[0].round()  # corners and edges on centers of pixels
    x[1] = x[1, ::-1]  # mirrored
    inverse = rng.uniform(0.2, 2, (6, 4))
    image = np.zeros((17, 23))
    draw_quads(x, y, inverse, image)
    np.testing.assert_allclose(image, naive_quads(x, y, inverse, image.shape), rtol=1e-9)
    assert 0 < np.count_nonzero(image) < image.size


def test_noise_is_not_amplified_and_tears_no_holes():
    found = registered_room(noisy(SENSED, 0.005)).depth
    errors = found[SURFACES] / TRUTH[SURFACES] - 1
    assert np.isnan(errors).mean() < 5e-4
    assert np.nanstd(errors) < 0.005
    assert np.nanmax(np.abs(errors)) < 0.04


def test_surfaces_are_exact_and_without_holes_and_between_two_there_is_no_third():
    """Every value lies on the wall, the floor or the board, and changes sides within half a sample of the edge."""
    whole = registered_room(SENSED)
    found = whole.depth
    assert whole.interpolated and not whole.note
    np.testing.assert_allclose(found[SURFACES], TRUTH[SURFACES], rtol=1e-6)
    rays = Camera(COLOR.matrix).rays(np.argwhere(np.ones(COLOR_SHAPE, bool))[:, ::-1].astype(np.float64))
    wall = np.full(COLOR_SHAPE, 3.0)
    with np.errstate(divide="ignore"):
        floor = 1.1 / (rays[:, 1] + 0.1).reshape(COLOR_SHAPE)
    board = 1.5 / (0.5 * rays[:, 0] + 1).reshape(COLOR_SHAPE)
    crease = near_edges((PLANE == 1).astype(np.uint8), 8)  # of wall and floor, which is no step
    known = INSIDE & np.isfinite(found) & ~crease
    closest = np.min([np.abs(found / surface - 1) for surface in (wall, floor, board)], axis=0)
    assert np.mean(closest[known] < 1e-6) > 0.998
    assert closest[known].max() < 0.005  # half a sample of the board, where a row shows two samples of it
    far_from_edge = known & ~near_edges((PLANE == 2).astype(np.uint8), 4)
    np.testing.assert_allclose(found[far_from_edge], TRUTH[far_from_edge], rtol=0.005)


def test_gaps_stay_gaps_and_what_is_hidden_stays_unknown():
    holed = SENSED.copy()
    holed[10:14, 10:13] = np.nan
    found, whole = registered_room(holed).depth, registered_room(SENSED).depth
    gap = np.isnan(found) & np.isfinite(whole)
    assert np.count_nonzero(gap) == pytest.approx(4 * 3 * 7.4**2, rel=0.1)
    np.testing.assert_allclose(found[~gap], whole[~gap], rtol=1e-6)
    # The board hides a strip of the wall on its left from the depth camera, which stands 3 cm to the right.
    board = np.nonzero(PLANE[150] == 2)[0].min()
    strip = COLOR.fx * 0.03 * (TRUTH[150, board - 9] - TRUTH[150, board]) / (3 * TRUTH[150, board])
    assert np.count_nonzero(np.isnan(whole[150, board - 12 : board + 12])) == pytest.approx(strip, abs=4)


def test_a_nearer_surface_hides_a_farther_one():
    """The wall, seen by a depth camera beside, is hidden behind the strip before it."""
    matrix = Camera(Intrinsics(20.0, 20.0, 15.5, 11.5).matrix)
    sensor = ColorAndDepth(matrix, matrix.scaled(5), np.eye(3), np.array([-0.2, 0, 0]))
    depth = np.full((24, 32), 2.0, np.float32)
    depth[:, 20:24] = 1.0
    seen = sensor.register(depth, (120, 160))
    # Columns 20 to 24 at 1 m move by 20 pixels to the left, the wall by 10.
    expected = np.repeat([2, 1, np.nan, 2, np.nan], (80, 20, 10, 40, 10))
    np.testing.assert_array_equal(seen, np.tile(expected, (120, 1)))


def test_a_map_of_the_same_aspect_is_taken_as_registered():
    depth = rendered(Intrinsics(90.5, 90.0, 59.25, 44.625), (90, 120))[0].astype(np.float32)
    found = registered(depth, COLOR_SHAPE, None, None, None)
    assert found.interpolated
    assert found.note.startswith("120 x 90, taken as registered to the color image of 480 x 360 and scaled")
    np.testing.assert_allclose(found.depth[SURFACES], TRUTH[SURFACES], rtol=1e-5)
    known = registered(depth, COLOR_SHAPE, COLOR, None, None).depth
    np.testing.assert_allclose(known, found.depth, rtol=1e-5)
    assert registered(depth[:-1], COLOR_SHAPE, None, None, None).interpolated  # 119 rows fit within a pixel
    same = registered(TRUTH.astype(np.float32), COLOR_SHAPE, COLOR, None, None)
    assert (same.interpolated, same.note) == (False, "")


@pytest.mark.parametrize(("shape", "color", "camera", "place"), [
    ((48, 64), None, DEPTH, None),
    ((48, 64), COLOR, None, PLACE),
    ((48, 60), COLOR, None, None),
    ((48, 64), COLOR, Intrinsics(0, 1, 2, 3), None),
    ((48, 64), COLOR, DEPTH, ((0.0,) * 9, (0.0,) * 3)),
    ((48, 64), COLOR, DEPTH, (PLACE[0], (30.0, 0, 0))),
    ((48, 64), COLOR, DEPTH, ((-1.0, 0, 0, 0, 1, 0, 0, 0, -1), (0.0, 0, 0))),
])  # fmt: skip
def test_cameras_that_do_not_fit_are_refused(shape, color, camera, place):
    refused(InputError, registered, np.full(shape, 2, np.float32), COLOR_SHAPE, color, camera, place)
