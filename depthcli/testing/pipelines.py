"""What the pipelines of every command promise: of pairs, of a sensor's frames, of frames with glass, of volumes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus, Status
from depthcli.core.result import DepthResult
from depthcli.core.volumes import RegisteredPair
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.registration.pipeline import RegistrationPipeline
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.testing.features import soft_volume
from depthcli.testing.frames import gaps, glass
from depthcli.testing.inputs import TINY, assert_pure, run_checks, shifted_pair

_SHIFT, _RANGE = 6, 16


def check_stereo_pipeline(pipeline: StereoPipeline) -> None:
    """Raise AssertionError unless a pipeline of ``stereo`` keeps what the command relies on; takes some seconds."""
    run_checks(pipeline, STEREO_CHECKS)


def check_kinect_pipeline(pipeline: KinectPipeline) -> None:
    """Raise AssertionError unless a pipeline of ``refine-kinect`` keeps what the command relies on."""
    run_checks(pipeline, KINECT_CHECKS)


def check_transparent_pipeline(pipeline: TransparentPipeline) -> None:
    """Raise AssertionError unless a pipeline of ``transparent`` keeps what the command relies on."""
    run_checks(pipeline, TRANSPARENT_CHECKS)


def check_registration_pipeline(pipeline: RegistrationPipeline) -> None:
    """Raise AssertionError unless a pipeline of ``register-confidence`` keeps what the command relies on."""
    run_checks(pipeline, REGISTRATION_CHECKS)


def a_plane_has_its_disparity(pipeline: StereoPipeline) -> None:
    """On a plane of random texture, at least 90 % of the pixels inside have the true disparity within a pixel."""
    for color in (False, True):
        found = pipeline(shifted_pair(60, 100, _SHIFT, color), _RANGE - 1).disparity.values[12:-12, 28:-12]
        share = np.mean(np.abs(found - _SHIFT) <= 1)
        assert share >= 0.9, f"{share:.0%} of the pixels do"


def maps_of_any_size(pipeline: StereoPipeline) -> None:
    """Pairs of any size have float32 maps of their size within the range, and pixels without a value have a reason."""
    reasons = Status.OCCLUDED | Status.MISMATCH | Status.OUT_OF_RANGE | Status.NO_DATA
    for height, width, disparities in TINY:
        found = pipeline(shifted_pair(height, width, 1, seed=width), disparities - 1).disparity
        values = found.values
        assert values.shape == (height, width), f"want {(height, width)}, got {values.shape}"
        assert values.dtype == np.float32, f"want float32, got {values.dtype}"
        known = values[~np.isnan(values)]
        assert np.all((known >= 0) & (known <= disparities - 1)), f"a value is outside 0 .. {disparities - 1}"
        assert np.all(found.status[np.isnan(values)] & reasons), "a pixel has neither value nor reason"


def same_disparities_at_any_number_of_threads(pipeline: StereoPipeline) -> None:
    """The map does not depend on the number of threads, and the images stay as they were."""
    pair = shifted_pair(41, 70, 3, noise=9)
    assert_pure(lambda: np.nan_to_num(pipeline(pair, 15).disparity.values, nan=-1), pair.left, pair.right)


def memory_grows_with_the_pair(pipeline: StereoPipeline) -> None:
    """``peak_bytes`` is positive, and not less for a larger pair."""
    small, large = pipeline.peak_bytes((60, 100), 15), pipeline.peak_bytes((600, 1000), 15)
    assert 0 < small <= large, f"peak_bytes says {small} bytes of 60 x 100 pixels, {large} of 600 x 1000"


def _check_depth(result: DepthResult, frame: RgbdFrame) -> None:
    depth = result.depth
    assert depth.values.shape == frame.shape, f"want {frame.shape}, got {depth.values.shape}"
    assert depth.values.dtype == np.float32, f"want float32, got {depth.values.dtype}"
    assert not np.isinf(depth.values).any(), "a depth is infinite"
    empty = (depth.status & DepthStatus.EMPTY) > 0
    np.testing.assert_array_equal(empty, np.isnan(depth.values), "want EMPTY where there is no depth, and only there")
    put_in = (depth.status & (DepthStatus.GAP_FILLED | DepthStatus.FALLBACK)) > 0
    np.testing.assert_array_equal(
        put_in | empty, np.isnan(frame.depth), "want GAP_FILLED, FALLBACK or EMPTY where the sensor has no depth"
    )


def gaps_are_filled(pipeline: KinectPipeline) -> None:
    """Nine tenths of the gaps are filled, most of them right within 5 %, and the status says so."""
    frame, truth = gaps()
    result = pipeline(frame)
    _check_depth(result, frame)
    gap = np.isnan(frame.depth)
    filled = np.isfinite(result.depth.values[gap]).mean()
    assert filled > 0.9, f"{filled:.0%} of the gaps are filled"
    right = np.mean(np.abs(result.depth.values - truth)[gap] < 0.05 * truth[gap])
    assert right > 0.7, f"{right:.0%} of the gaps are right within 5 %"


def frames_of_any_size(pipeline: KinectPipeline) -> None:
    """Frames of a single pixel, row or column keep their depth, where nothing else is to be seen."""
    for shape in ((1, 1), (1, 30), (30, 1), (4, 5)):
        depth = np.full(shape, 2, np.float32)
        if depth.size > 1:
            depth.flat[depth.size // 2] = np.nan
        values = pipeline(RgbdFrame(np.zeros((*shape, 3), np.uint8), depth)).depth.values
        np.testing.assert_allclose(values[~np.isnan(values)], 2, rtol=1e-3)


def nothing_known_is_an_error(pipeline: KinectPipeline) -> None:
    """A frame without any depth raises ValueError."""
    try:
        pipeline(RgbdFrame(np.zeros((8, 9, 3), np.uint8), np.full((8, 9), np.nan, np.float32)))
    except ValueError:
        return
    raise AssertionError("it returns a map")


def same_depth_at_any_number_of_threads(pipeline: KinectPipeline) -> None:
    """The map does not depend on the number of threads, and the frame stays as it was."""
    frame, _ = gaps(1)
    assert_pure(lambda: pipeline(frame).depth.values, frame.color, frame.depth)


def every_pixel_has_a_depth(pipeline: TransparentPipeline) -> None:
    """Every pixel of a frame with samples has a depth, and the status says where it comes from."""
    frame, _, _ = glass()
    result = pipeline(frame)
    _check_depth(result, frame)
    depth, status = result.depth.values, result.depth.status
    assert np.isfinite(depth).all(), "some pixels have no depth"
    kept = status == DepthStatus.KEPT
    np.testing.assert_array_equal(depth[kept], frame.depth[kept], "a value that is KEPT has changed")
    unreliable = result.pictures["unreliable"] > 0
    np.testing.assert_array_equal(
        unreliable, (status & DepthStatus.CORRECTED) > 0, "the picture `unreliable` differs from CORRECTED"
    )
    sampled = (status & DepthStatus.SAMPLED) > 0
    assert sampled.any(), "no pixel is SAMPLED"
    assert not (sampled & (kept | np.isnan(frame.sparse))).any(), "a pixel without a sample, or KEPT, is SAMPLED"
    assert result.seconds, "seconds: none"


def no_samples_are_no_error(pipeline: TransparentPipeline) -> None:
    """A single sample, or none, gives a map without infinite values."""
    frame, _, _ = glass(5)
    nothing = np.full(frame.shape, np.nan, np.float32)
    one = nothing.copy()
    one[3, 4] = frame.depth[3, 4]
    for sparse in (one, nothing):
        values = pipeline(replace(frame, sparse=sparse)).depth.values
        assert values.shape == frame.shape and not np.isinf(values).any(), "a depth is infinite"


def same_dense_depth_at_any_number_of_threads(pipeline: TransparentPipeline) -> None:
    """The map does not depend on the number of threads, and the frame stays as it was."""
    frame, _, _ = glass(3)
    assert_pure(lambda: pipeline(frame).depth.values, frame.color, frame.depth, frame.sparse)


def _moved_volumes(voxels: int) -> RegisteredPair:
    fixed = soft_volume(3, (16, 20, 24))
    return RegisteredPair(fixed, np.roll(fixed, voxels, axis=2), (1.0, 1.0, 1.0))


def errors_are_lengths(pipeline: RegistrationPipeline) -> None:
    """Expected errors are finite float32 in mm, none negative, on a grid within the fixed volume."""
    pair = _moved_volumes(2)
    result = pipeline(pair)
    error = result.expected_error
    assert error.dtype == np.float32 and error.ndim == 3, f"want (z, y, x) float32, got {error.shape} {error.dtype}"
    assert np.isfinite(error).all() and error.min() >= 0, "an error is NaN, infinite or negative"
    ends = [s + d * (n - 1) for s, d, n in zip(result.start, result.step, error.shape, strict=True)]
    inside = all(s >= -1 and e <= n for s, e, n in zip(result.start, ends, pair.shape, strict=True))
    assert inside, f"start {result.start} and step {result.step} lead outside of the volume"
    assert result.shift is None or result.shift.shape == (3, *error.shape), "shift: want (3, z, y, x)"
    assert "mean_error" in result.figures, "figures: no mean_error"


def same_errors_at_any_number_of_threads(pipeline: RegistrationPipeline) -> None:
    """The errors do not depend on the number of threads, and the volumes stay as they were."""
    pair = _moved_volumes(1)
    assert_pure(lambda: pipeline(pair).expected_error, pair.fixed, pair.warped)


def memory_grows_with_the_volume(pipeline: RegistrationPipeline) -> None:
    """``peak_bytes`` is positive, and not less for a larger volume."""
    small, large = (pipeline.peak_bytes((n, n, n), (1.0, 1.0, 1.0)) for n in (20, 60))
    assert 0 < small <= large, f"peak_bytes says {small} bytes of 20^3 voxels, {large} of 60^3"


STEREO_CHECKS = (
    a_plane_has_its_disparity,
    maps_of_any_size,
    same_disparities_at_any_number_of_threads,
    memory_grows_with_the_pair,
)
KINECT_CHECKS = (
    gaps_are_filled,
    frames_of_any_size,
    nothing_known_is_an_error,
    same_depth_at_any_number_of_threads,
)
TRANSPARENT_CHECKS = (
    every_pixel_has_a_depth,
    no_samples_are_no_error,
    same_dense_depth_at_any_number_of_threads,
)
REGISTRATION_CHECKS = (errors_are_lengths, same_errors_at_any_number_of_threads, memory_grows_with_the_volume)
"""One function a promise."""
