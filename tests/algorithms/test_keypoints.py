"""Upright SURF under changes of the picture, and key points matched along epipolar lines, against naive references."""

import cv2
import numpy as np
import pytest

from depthcli.algorithms.keypoints import KeyPoints, surf
from depthcli.algorithms.keypoints.sift import Sift
from depthcli.algorithms.keypoints.surf import Surf
from depthcli.kernels.jit import run_bands
from depthcli.methods.stereo.keypoint_matching import KeyPointMatching
from tests.contracts.inputs import blobs
from tests.naive import segments as naive


@pytest.mark.parametrize(("size", "step"), [(9, 1), (15, 1), (27, 2)])
def test_hessian_agrees_with_explicit_masks(size, step):
    image = np.random.default_rng(2).random((40, 47)).astype(np.float32)
    integral = cv2.integral(image, sdepth=cv2.CV_64F)
    shape = -(-40 // step), -(-47 // step)
    responses, signs = np.zeros(shape, np.float32), np.zeros(shape, np.int8)
    run_bands(surf._hessian, shape[0], integral, step, size, responses, signs)
    half = size // 2
    for j, i in np.ndindex(shape):
        y, x = j * step, i * step
        if half <= y < 40 - half and half <= x < 47 - half:
            determinant, sign = naive.hessian(image, y, x, size)
            assert responses[j, i] == pytest.approx(determinant, abs=1e-6)
            assert signs[j, i] == sign
        else:
            assert responses[j, i] == 0


@pytest.mark.parametrize("detector", [Sift(), Surf()], ids=["sift", "surf"])
@pytest.mark.parametrize(("y", "x", "deviation"), [(100, 120, 3), (100.3, 119.6, 3), (100, 120, 6)])
@pytest.mark.parametrize("dark", [True, False])
def test_a_blob_is_found_where_it_is_with_its_deviation_as_scale(detector, y, x, deviation, dark):
    rows, columns = np.mgrid[:200, :240]
    bump = 120 * np.exp(-((rows - y) ** 2 + (columns - x) ** 2) / (2 * deviation**2))
    points = detector(np.rint(200 - bump if dark else 40 + bump).astype(np.uint8))
    off, sign = (0.2, 1 if dark else -1) if isinstance(detector, Surf) else (0.3, 0)  # SIFT is a quarter pixel off
    assert (points.x[0], points.y[0]) == pytest.approx((x, y), abs=off)
    assert points.scale[0] == pytest.approx(0.8 * deviation, abs=0.12 * deviation)
    assert points.sign[0] == sign


@pytest.mark.parametrize(("angle", "scale", "least"), [(5, 1.0, 0.75), (10, 1.0, 0.6), (0, 1.15, 0.6), (0, 0.85, 0.6)])
def test_found_again_after_small_rotation_and_scaling(angle, scale, least):
    picture = blobs(240, 240, seed=4)
    matrix = cv2.getRotationMatrix2D((119.5, 119.5), angle, scale)
    changed = cv2.warpAffine(picture, matrix, (240, 240), flags=cv2.INTER_CUBIC)
    points, moved = Surf(threshold=1e-4, octaves=3)(picture), Surf(octaves=3)(changed)
    inner = np.hypot(points.x - 119.5, points.y - 119.5) < 70
    assert inner.sum() > 30
    x, y = matrix @ np.stack([points.x, points.y, np.ones(len(points))])
    near = np.hypot(moved.x - x[:, None], moved.y - y[:, None]) < 1.5
    alike = np.linalg.norm(moved.descriptors - points.descriptors[:, None], axis=2) < 0.35
    assert (near & alike).any(axis=1)[inner].mean() > least  # where expected, with a similar description


def _points(rng, count):
    descriptors = rng.random((count, 8)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True) + 1e-9
    values = (rng.uniform(*ends, count).astype(np.float32) for ends in ((0, 40), (0, 4), (1, 1.3), (0, 1)))
    return KeyPoints(*values, rng.choice([-1, 1], count).astype(np.int8), descriptors)


@pytest.mark.parametrize("counts", [(0, 0), (0, 5), (5, 0), (1, 1), (40, 50), (90, 60)])
@pytest.mark.parametrize("ratio", [0.7, 1.0])
def test_agrees_with_the_naive_matcher(counts, ratio):
    rng = np.random.default_rng(sum(counts))
    left, right = _points(rng, counts[0]), _points(rng, counts[1])
    settings = dict(ratio=ratio, max_distance=0.9, max_scale_ratio=1.1)
    found = KeyPointMatching(**settings, agreeing=0)(left, right, 20)
    pairs = set(zip(found.left.tolist(), found.right.tolist(), strict=True))
    assert pairs == naive.matches(left, right, 20, 0.5, **settings)
    assert np.array_equal(found.disparity, left.x[found.left] - right.x[found.right])
