"""What key points of images and features of volumes promise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.keypoints import Detector, KeyPoints
from depthcli.methods.registration.feature import VolumeFeature
from depthcli.methods.registration.search import search
from depthcli.testing.inputs import assert_pure, run_checks


def check_keypoint_detector(detector: Detector) -> None:
    """Raise AssertionError unless a detector of key points keeps what its users rely on."""
    run_checks(detector, KEYPOINT_CHECKS)


def check_volume_feature(feature: VolumeFeature) -> None:
    """Raise AssertionError unless a feature of ``register-confidence`` keeps what the search relies on."""
    run_checks(feature, VOLUME_CHECKS)


def blobs(height: int = 120, width: int = 160, seed: int = 0) -> NDArray[np.uint8]:
    """Return an (H, W) picture of soft blobs of several sizes, 0 .. 255."""
    rng = np.random.default_rng(seed)
    picture = sum(cv2.GaussianBlur(rng.random((height, width)), (0, 0), s) * s for s in (1.5, 3, 6))
    picture = np.asarray(picture - np.min(picture))
    return np.asarray(picture / (picture.max() or 1) * 255, np.uint8)


def soft_volume(seed: int, shape: tuple[int, int, int] = (20, 20, 20)) -> NDArray[np.float32]:
    """Return a (Z, Y, X) float32 volume of soft random values around 0."""
    values = np.random.default_rng(seed).standard_normal(shape).astype(np.float32)
    for axis in range(3):
        values += np.roll(values, 1, axis) + np.roll(values, -1, axis)
    return values * np.float32(100 / 27)


def _checked(points: KeyPoints, shape: tuple[int, ...]) -> KeyPoints:
    n, (height, width) = len(points), shape
    for name in ("x", "y", "scale", "response"):
        values = getattr(points, name)
        assert values.shape == (n,) and values.dtype == np.float32, f"{name}: want ({n},) float32"
        assert np.isfinite(values).all(), f"{name}: some are NaN or infinite"
    assert points.sign.shape == (n,) and points.sign.dtype == np.int8, f"sign: want ({n},) int8"
    assert set(np.unique(points.sign)) <= {-1, 0, 1}, "sign: want -1, 0 or 1"
    inside = (points.x >= -0.5) & (points.x <= width - 0.5) & (points.y >= -0.5) & (points.y <= height - 0.5)
    assert inside.all(), "a point lies outside the image"
    assert np.all(np.diff(points.response) <= 0), "want the strongest first"
    descriptors = points.descriptors
    assert descriptors.ndim == 2 and len(descriptors) == n and descriptors.dtype == np.float32, (
        f"descriptors: want ({n}, K) float32, got {descriptors.shape} {descriptors.dtype}"
    )
    np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), 1, atol=1e-3, err_msg="descriptors: want length 1")
    return points


def points_move_with_the_image(detector: Detector) -> None:
    """Half of the points of an image lie, with the nearest descriptor, at the moved places of the moved image."""
    image = blobs()
    one, other = (_checked(detector(np.ascontiguousarray(each)), each.shape) for each in (image[:, 8:], image[:, :-8]))
    assert len(one) and len(other), "a picture of blobs has no points"
    nearest = (one.descriptors @ other.descriptors.T).argmax(axis=1)
    moved = np.hypot(other.x[nearest] - one.x - 8, other.y[nearest] - one.y) < 1
    assert moved.mean() > 0.5, f"{moved.mean():.0%} do"


def plain_and_tiny_images_have_points_or_none(detector: Detector) -> None:
    """Images of a single pixel, row or color are no error."""
    for shape in ((1, 1), (1, 40), (40, 1), (7, 9), (33, 31)):
        for image in (np.full(shape, 90, np.uint8), blobs(*shape)):
            _checked(detector(image), shape)


def same_points_at_any_number_of_threads(detector: Detector) -> None:
    """The points do not depend on the number of threads, and the image stays as it was."""
    image = blobs(seed=1)

    def run() -> NDArray[np.float32]:
        points = detector(image)
        return np.column_stack([points.x, points.y, points.scale, points.response, points.sign, points.descriptors])

    assert_pure(run, image)


def the_true_shift_is_cheapest(feature: VolumeFeature) -> None:
    """The search finds the shift of a moved volume within 0.3 voxels."""
    wide = soft_volume(0, (24, 24, 24))
    fixed, warped = wide[2:22, 2:22, 2:22].copy(), wide[2:22, 1:21, 4:24].copy()
    one, other = feature(fixed, warped)
    found = search(one, other, 1.0, 3, 2)
    middle = (slice(7, 13),) * 3
    for axis, shift in ((1, 1), (2, -2)):
        median = np.median(found.displacement[(axis, *middle)])
        assert abs(median - shift) <= 0.3, f"it finds {median:.2f} voxels instead of {shift}"


def same_channels_at_any_number_of_threads(feature: VolumeFeature) -> None:
    """The channels are uint8, do not depend on the number of threads, and the volumes stay as they were."""
    fixed, warped = soft_volume(1), soft_volume(2)
    for channels in feature(fixed, warped):
        assert channels.dtype == np.uint8, f"want uint8, got {channels.dtype}"
        assert channels.shape[1:] == fixed.shape, f"want (C, {fixed.shape}), got {channels.shape}"
        assert len(channels) <= feature.channels, f"channels says {feature.channels}, there are {len(channels)}"
    assert_pure(lambda: np.concatenate(feature(fixed, warped)), fixed, warped)


def equal_volumes_have_equal_channels(feature: VolumeFeature) -> None:
    """Two equal volumes have equal channels, whatever their size."""
    for shape in ((1, 9, 7), (3, 1, 5), (2, 2, 2)):
        for volume in (np.zeros(shape, np.float32), soft_volume(3, shape)):
            one, other = feature(volume, volume)
            assert one.shape[1:] == shape, f"want (C, {shape}), got {one.shape}"
            np.testing.assert_array_equal(one, other)


KEYPOINT_CHECKS = (
    points_move_with_the_image,
    plain_and_tiny_images_have_points_or_none,
    same_points_at_any_number_of_threads,
)
VOLUME_CHECKS = (
    same_channels_at_any_number_of_threads,
    the_true_shift_is_cheapest,
    equal_volumes_have_equal_channels,
)
"""One function a promise."""
