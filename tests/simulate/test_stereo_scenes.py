"""Generated scenes: the truth must be what the pictures show."""

import cv2
import numpy as np
import pytest

from depthcli.core.errors import ConfigError
from depthcli.simulate import textures
from depthcli.simulate.rendering import disparities, render
from depthcli.simulate.room import Room, Surface, rotation
from depthcli.simulate.samples import sample_scenes
from depthcli.simulate.stereo_scenes import KINDS, Radiometry, SyntheticScene, make_scene
from tests.golden import refused

CASES = [(kind, seed) for kind in KINDS for seed in (0, 3)]


@pytest.fixture(scope="module")
def scenes() -> dict[tuple[str, int], SyntheticScene]:
    with pytest.MonkeyPatch.context() as patch:  # what is mirrored is not where the truth says
        drawn = textures.surroundings
        patch.setattr(textures, "surroundings", lambda *arguments: 0 * drawn(*arguments))
        return {(kind, seed): make_scene(kind, seed, 200, 150, 24) for kind, seed in CASES}


def _warped(image: np.ndarray, disparity: np.ndarray) -> np.ndarray:
    rows, columns = np.indices(disparity.shape, np.float32)
    position = np.asarray(columns - disparity, np.float32)
    return cv2.remap(image.astype(np.float32), position, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=str)
def test_truth_maps_right_view_onto_left(scenes, case):
    scene, shifts = scenes[case], np.linspace(-0.5, 0.5, 11)
    warped = (_warped(scene.right, scene.disparity_left + shift) for shift in shifts)
    errors = np.array([np.mean((image - scene.left)[scene.nonocc & ~scene.disc] ** 2) for image in warped])
    assert np.sqrt(errors[5]) < 4.0
    # The error is smallest at the truth itself: a parabola through it has its vertex within a tenth of a
    # pixel of 0, where rounding the disparity or taking pixel corners for centres would move it by a half.
    curvature, slope, _ = np.polyfit(shifts, errors, 2)
    assert curvature > 0 and abs(-slope / (2 * curvature)) < 0.1
    assert errors[[0, -1]].min() > 3 * errors[5]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_occlusion_is_what_a_left_right_check_finds(scenes, case):
    scene = scenes[case]
    found = np.zeros(scene.nonocc.shape, bool)
    for y, x in np.ndindex(found.shape):
        d = scene.disparity_left[y, x]
        low = int(np.floor(x - d))
        # Visible where the right view's surface is no nearer than this point is.
        found[y, x] = low >= 0 and scene.disparity_right[y, low : low + 2].min() <= d + 0.6
    # The check sees the right view at whole pixels only, so it may differ at outlines.
    assert np.mean(found != scene.nonocc) < (0.016 if case[0] == "street" else 0.012)  # poles are all outline
    edges = (cv2.morphologyEx((~mask).astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0
             for mask in (scene.nonocc, found))  # fmt: skip
    assert not ((found != scene.nonocc) & ~np.logical_or(*edges)).any()
    assert 0.02 < np.mean(~scene.nonocc) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("width", "height", "top"), [(96, 72, 12), (16, 16, 8), (120, 40, 60), (40, 90, 4)])
def test_every_pixel_has_a_disparity_in_range(kind, width, height, top):
    for seed in range(2):
        scene = make_scene(kind, seed, width, height, top, supersampling=1)
        for disparity in (scene.disparity_left, scene.disparity_right):
            assert disparity.shape == (height, width) and disparity.dtype == np.float32
            assert np.all((disparity > 0) & (disparity <= top))
        for image in (scene.left, scene.right):
            assert image.shape == (height, width, 3) and image.dtype == np.uint8
        assert not (scene.disc & ~scene.nonocc).any()


@pytest.mark.parametrize("seed", range(2))
def test_repetitive_pattern_matches_one_period_off(seed):
    scene = make_scene("repetitive", seed, 400, 300, 48)
    inner = np.isfinite(scene.repetition) & scene.nonocc & ~scene.disc
    inner[:, :48] = False
    assert inner.mean() > 0.3
    d, period = scene.disparity_left, np.nan_to_num(scene.repetition)
    assert np.all(((d >= period) & (d + period <= scene.max_disparity))[inner])

    def cost(at: np.ndarray) -> np.ndarray:
        difference = np.abs(_warped(scene.right, at) - scene.left.astype(np.float32)).mean(axis=2)
        return cv2.blur(difference, (9, 9))

    for side in (-1, 1):
        before, here, after = (cost(d + (side + step) * period) for step in (-0.3, 0, 0.3))
        # Stickers break the pattern, so not everywhere.
        assert np.mean((here < 0.5 * np.minimum(before, after))[inner]) > 0.5
    assert np.all(np.isnan(make_scene("planes", seed, 64, 48, 8).repetition))


def test_noise_has_the_deviation_asked_for():
    clean, noisy = (make_scene("planes", 1, 160, 120, 20, noise=sigma) for sigma in (0, 6))
    np.testing.assert_array_equal(clean.disparity_left, noisy.disparity_left)
    np.testing.assert_array_equal(clean.nonocc, noisy.nonocc)
    differences = [noisy.left.astype(int) - clean.left, noisy.right.astype(int) - clean.right]
    for image, difference in zip((clean.left, clean.right), differences, strict=True):
        inside = difference[(image > 30) & (image < 225)]
        assert abs(inside.std() - 6) < 0.3 and abs(inside.mean()) < 0.2
    assert not np.array_equal(*differences)


def test_radiometry_changes_the_right_view_only_and_as_said():
    plain, changed, dark = (
        make_scene("foreground", 2, 96, 72, 12, radiometry=radiometry)
        for radiometry in (Radiometry(), Radiometry(0.8, 10, 1.2, 0.0), Radiometry(vignetting=0.5))
    )
    np.testing.assert_array_equal(plain.left, changed.left)
    np.testing.assert_array_equal(plain.disparity_left, changed.disparity_left)
    expected = 255 * 0.8 * (plain.right / 255.0) ** 1.2 + 10
    unclipped = plain.right < 255
    np.testing.assert_allclose(changed.right[unclipped], expected[unclipped], atol=1.1)
    ratio = dark.right.sum(axis=2) / np.maximum(plain.right.sum(axis=2), 1)
    assert (ratio[0, 0], ratio[36, 48]) == pytest.approx((0.5, 1), abs=0.03)
    assert Radiometry.of_strength(0) == Radiometry()


def test_impossible_sizes_and_kinds_are_refused():
    given = {"count": 2, "seed": 0, "width": 96, "height": 72, "max_disparity": 12, "kind": ["planes", "cubes"]}
    refused(ConfigError, sample_scenes, "stereo", given)
    for width, height, top in ((96, 10, 12), (10, 72, 4), (96, 72, 60), (96, 72, 2)):
        refused(ValueError, make_scene, "planes", 0, width, height, top)


@pytest.mark.parametrize("shape", ["sphere", "cylinder", "cone"])
def test_rays_hit_curved_surfaces_where_marching_along_them_does(shape):
    half = np.array([1.2, 0.8, 0.9] if shape == "sphere" else [0.9, 1.1, 0.9])
    turn = rotation(0.4, -0.3, 0.5)
    surface = Surface(shape, np.array([0.3, -0.2, 6.0]), turn, half, np.zeros((2, 2, 3), np.float32))
    direction = (*np.random.default_rng(8).uniform(-0.4, 0.4, (2, 300)), np.ones(300))
    origin = (np.ones(300), np.zeros(300), np.zeros(300))
    found = surface.hit(origin, direction)
    steps, expected = np.linspace(3, 9, 6001), np.full(300, np.inf)
    for ray, (start, along) in enumerate(zip(np.transpose(origin), np.transpose(direction), strict=True)):
        x, y, z = (((start + steps[:, None] * along - surface.center) @ turn.T) / half).T
        value = x**2 + z**2 - {"sphere": 1 - y**2, "cylinder": 1, "cone": ((y + 1) / 2) ** 2}[shape]
        inside = np.abs(y) <= 1
        crossings = np.flatnonzero((np.sign(value[1:]) != np.sign(value[:-1])) & inside[1:] & inside[:-1])
        if crossings.size:
            expected[ray] = steps[crossings[0]]
    assert 20 < np.isfinite(expected).sum() < 280
    assert np.sum(np.isfinite(found) != np.isfinite(expected)) <= 3  # grazing rays fall between two steps
    both = np.isfinite(found) & np.isfinite(expected)
    assert np.mean(np.abs(found[both] - expected[both]) < 2e-3) > 0.98


def test_a_board_lies_where_pinhole_cameras_see_it():
    room = Room(np.random.default_rng(0), 64, 48, 16, 1.0)
    white, black = np.ones((2, 2, 3), np.float32), np.zeros((2, 2, 3), np.float32)
    room.surfaces = [
        Surface("plane", room.at(32, 24, 2), rotation(), np.ones(3), black, unbounded=True),
        Surface("plane", room.at(25.5, 20, 8), rotation(), np.array([10.25, 8, 8]) / 8, white),
    ]
    room.light = np.array([0.0, 0.0, -1e6])  # the same everywhere
    for right, shift, picture in zip((False, True), (0, 8), render(room, 4), strict=True):
        seen = picture[:, :, 0] / picture[20, 20, 0]
        # Edges at 15.25 and 35.75, rows 12 and 28: a pixel's value is the share of it that the board covers.
        np.testing.assert_allclose(seen[20, np.array([14, 15, 16, 35, 36, 37]) - shift] > 0, [0, 1, 1, 1, 1, 0])
        edges = seen[20, 15 - shift], seen[20, 36 - shift], seen[12, 20], seen[28, 20]
        assert edges == pytest.approx((0.25, 0.25, 0.5, 0.5), abs=0.03)
        disparity, owner = disparities(room, right)
        np.testing.assert_array_equal(np.flatnonzero(owner[20] == 1), np.arange(16, 36) - shift)
        np.testing.assert_allclose(disparity[20], np.where(owner[20] == 1, 8, 2))
