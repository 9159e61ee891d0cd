"""Cameras, frames and volumes: what is impossible is refused, what is shown is as bright and hangs as it should."""

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest

from depthcli.core.cameras.camera import Camera, Intrinsics
from depthcli.core.cameras.rig import Rig
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.errors import InputError
from depthcli.core.frames import RgbdFrame, SparseFrame, StereoPair, infrared_image
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.volumes import Grid, RegisteredPair
from tests.golden import refused, told

MATRIX = np.array([[190.0, 0, 98], [0, 192, 77], [0, 0, 1]])
CAMERA = Camera(MATRIX, (0.05, -0.03, 0.001, -0.001, 0.0))


def test_impossible_cameras_and_rigs_are_refused():
    for matrix, lens, fisheye in (
        (np.zeros((3, 3)), (0,) * 5, False),
        (np.full((3, 3), np.nan), (0,) * 5, False),
        (np.ones((3, 3)), (0,) * 5, False),
        (MATRIX, (0.1, 0.2), False),
        (MATRIX, (0,) * 5, True),
        (MATRIX, (0, 0, 0, np.inf), False),
    ):
        refused(InputError, Camera, matrix, lens, None, fisheye)
    values = {"left": CAMERA, "right": CAMERA, "rotation": np.eye(3), "translation": np.array([-0.1, 0, 0])}
    for changes in (
        *({"rotation": matrix} for matrix in (2 * np.eye(3), -np.eye(3), np.eye(2))),
        *({"translation": shift} for shift in (np.zeros(3), np.array([np.nan, 0, 0]))),
        {"right": Camera(MATRIX, (0,) * 4, None, True)},
    ):
        refused(InputError, Rig, **{**values, **changes})
    rig = Rig(Camera(MATRIX, (0,) * 5, (200, 150)), CAMERA, np.eye(3), np.array([-0.1, 0, 0]))
    refused(InputError, rig.rectified, (200, 151), (200, 150))
    refused(InputError, rig.rectified, (200, 150), (900, 150))
    lens = Intrinsics(190, 192, 98, 77)
    assert PairGeometry(lens, 0.1).fb == pytest.approx(19)
    for of, baseline, offset in (
        (lens, np.inf, 0), (lens, 0.1, np.nan), (replace(lens, fx=np.inf), 0.1, 0), (replace(lens, fy=0), 0.1, 0),
        (lens, -0.1, 0),
    ):  # fmt: skip
        refused(InputError, PairGeometry, of, baseline, offset)


def test_a_camera_sees_a_point_on_the_ray_of_its_pixel_and_of_two_the_nearer_one():
    pixels = np.array([[20.0, 30.0], [150.0, 100.0]])
    points = np.column_stack([CAMERA.rays(pixels), np.ones(2)])
    cloud = np.concatenate([points, 2 * points, -points])
    depth, values = CAMERA.depth_image(cloud, (150, 200), np.arange(6, dtype=np.float32))
    expected = np.full((150, 200), np.nan, np.float32)
    expected[[30, 100], [20, 150]] = 1
    np.testing.assert_array_equal(depth, expected)
    assert (values[30, 20], values[100, 150]) == (0, 1)
    assert np.isnan(CAMERA.depth_image(-points, (150, 200), np.zeros(2, np.float32))).all()
    assert CAMERA.rays(np.zeros((0, 2))).shape == (0, 2)
    # Of an image of another size the corners of pixels stay.
    scaled = CAMERA.scaled((0.5, 2)).rays((pixels + 0.5) * (0.5, 2) - 0.5)
    np.testing.assert_allclose(scaled, CAMERA.rays(pixels), atol=1e-6)


@pytest.mark.parametrize("bits", [10, 12, 14, 16, None])
def test_largest_sample_is_white_whatever_its_bits(bits):
    top = (1 << (bits or 16)) - 1
    ramp = np.arange(0, top + 1, dtype=np.uint16)[None]
    pair = StereoPair(ramp, ramp.copy(), bits)
    np.testing.assert_array_equal(pair.grey[0], np.rint(ramp * (65535 / top)))
    wanted = np.rint(ramp * (255 / top))
    assert np.abs(pair.grey8[0] - wanted).max() <= (0 if bits in (16, None) else 1)
    assert pair.grey8[0].min() == 0 and pair.grey8[0].max() == 255
    assert np.all(np.diff(pair.grey8[0].astype(int)) >= 0)
    np.testing.assert_array_equal(pair.color8[0], np.repeat(pair.grey8[0][..., None], 3, axis=2))


def test_both_images_share_one_scale_and_larger_samples_are_white():
    left, right = np.full((1, 1, 3), 4095, np.uint16), np.full((1, 1, 3), 1000, np.uint16)
    pair = StereoPair(left, right, 12)
    assert [int(image[0, 0, 0]) for image in pair.color8] == [255, 62]
    assert int(StereoPair(left, right, 10).grey8[0][0, 0]) == 255
    byte = np.zeros((2, 2), np.uint8)
    assert StereoPair(byte, byte, 8).grey[0] is byte
    for bits in (0, 9):  # do not fit the type
        refused(ValueError, StereoPair, byte, byte, bits)
    refused(ValueError, StereoPair, byte, byte, None, byte[:1])


def test_infrared_is_white_above_999_of_1000_pixels():
    levels = infrared_image(np.arange(10_000, dtype=np.uint16)[None])[0]
    assert (levels[5000], levels[9950], levels[9990]) == (128, 254, 255)
    np.testing.assert_array_equal(infrared_image(np.array([[[7, 1, 2]]], np.uint8)), [[7]])  # the first channel


BYTES, FLOATS = np.zeros((4, 5), np.uint8), np.ones((4, 5), np.float32)
COLOR, CUBE = np.dstack([BYTES] * 3), np.ones((2, 4, 5), np.float32)


@pytest.mark.parametrize(("kind", "fitting", "others"), [
    (StereoPair, (BYTES, BYTES), [
        (BYTES, BYTES[1:]), (BYTES, BYTES.astype(np.uint16)), (FLOATS, FLOATS), (COLOR[..., :2], COLOR[..., :2]),
        (BYTES[0], BYTES[0])]),
    (RgbdFrame, (COLOR, FLOATS), [
        (BYTES, FLOATS), (COLOR, FLOATS[1:]), (COLOR, FLOATS.astype(float)), (COLOR / 2, FLOATS)]),
    (lambda sparse, trust: SparseFrame(COLOR, FLOATS, sparse=sparse, sparse_confidence=trust), (FLOATS, FLOATS), [
        (FLOATS[1:], None), (FLOATS, BYTES)]),
    (RgbIrFrame, (COLOR, BYTES, FLOATS), [(COLOR, COLOR, FLOATS), (COLOR, FLOATS, FLOATS), (COLOR, BYTES[1:], FLOATS)]),
    (DisparityMap, (FLOATS, BYTES), [(FLOATS, BYTES[1:]), (FLOATS, FLOATS), (BYTES, BYTES)]),
    (RegisteredPair, (CUBE, CUBE, (1, 1, 1), CUBE > 0), [
        (FLOATS, FLOATS, (1, 1, 1)), (CUBE, CUBE[1:], (1, 1, 1)), (CUBE, CUBE > 0, (1, 1, 1)),
        (CUBE, CUBE, (1, 1, 1), CUBE[1:] > 0), (CUBE, CUBE, (1, 1, 1), CUBE), (CUBE, CUBE, (1, 0, 1)),
        (CUBE, CUBE, (1, 1)), (CUBE, CUBE, (1, 1, np.inf)), (CUBE, CUBE * np.float32(np.nan), (1, 1, 1))]),
], ids=["pair", "color and depth", "sparse depth", "infrared", "map", "volumes"])  # fmt: skip
def test_arrays_that_do_not_fit_together_are_refused(kind, fitting, others):
    kind(*fitting)
    for wrong in others:
        with pytest.raises((ValueError, TypeError)) as caught:
            kind(*wrong)
        told(str(caught.value))


def test_pixels_of_a_map_are_told_apart_by_their_bits():
    status = np.array(
        [[0, Status.OCCLUDED | Status.FILLED, Status.MISMATCH | Status.FILLED, Status.OCCLUDED]], np.uint8
    )
    found = DisparityMap(np.array([[1, 2, 3, np.nan]], np.float32), status)
    assert found.density == 0.75
    for pixels, expected in (
        (found.valid, [1, 1, 1, 0]), (found.measured, [1, 0, 0, 0]), (found.filled, [0, 1, 1, 0]),
        (found.occluded, [0, 1, 0, 1]), (found.mismatched, [0, 0, 1, 0]),
    ):  # fmt: skip
        assert pixels.tolist() == [list(map(bool, expected))]


WORLD = ((2, 1), (1, -1), (0, -1))
"""Axis of the LPS frame, and its sign, that is positive towards superior, anterior and right."""


def rotation(degrees: float) -> np.ndarray:
    """A turn about an oblique axis (Rodrigues)."""
    x, y, z = np.array([1, 2, 3]) / np.sqrt(14)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def test_a_wall_is_as_far_after_rectification_and_back():
    turned = Rig(CAMERA, CAMERA, rotation(10), np.array([-0.1, 0.01, 0])).rectified((200, 150), (200, 150))
    depth = turned.rectify_depth(np.full((150, 200), 2, np.float32))
    back, _ = turned.unrectify_depth(depth, depth)
    assert np.nanmin(depth) < 1.99 and np.nanmean(abs(back - 2)) < 1e-4


@pytest.mark.parametrize("order", list(permutations(range(3))))
@pytest.mark.parametrize("signs", list(product((1, -1), repeat=3)))
@pytest.mark.parametrize("degrees", [0, 20])
def test_all_48_orientations_are_shown_alike(order, signs, degrees):
    direction = np.zeros((3, 3))
    for column, (row, sign) in enumerate(zip(order, signs, strict=True)):
        direction[row, column] = sign
    grid = Grid((4, 5, 6), (1.0, 2.0, 3.0), (7.0, -8.0, 9.0), tuple((rotation(degrees) @ direction).ravel()))
    places = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1).reshape(-1, 3).astype(float)
    points = grid.to_point(places).reshape(*grid.shape, 3)
    for axis, (world, sign) in enumerate(WORLD):
        towards_first_side = sign * grid.turned(points[..., world])
        assert (np.diff(towards_first_side, axis=axis) < 0).all()
        middle = [n // 2 if k != axis else slice(None) for k, n in enumerate(towards_first_side.shape)]
        first, step = grid.slice_positions(axis)
        along = towards_first_side[tuple(middle)]
        assert step == pytest.approx(np.diff(along)[0])
        if degrees == 0:
            assert first + step * np.arange(len(along)) == pytest.approx(along)
            assert -step == pytest.approx(grid.spacing[2 - grid.anatomical_axes()[0][axis]])
