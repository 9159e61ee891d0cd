"""Depth-guided segments as a whole: contract, status, accuracy on simulated frames."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
import yaml

from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus
from depthcli.core.method import Family
from depthcli.kernels.jit import set_threads
from depthcli.methods.kinect.pipeline.dsrm import Dsrm
from depthcli.simulate.depth_sensor import KinectSample, simulate_kinect
from depthcli.simulate.kinect_scenes import make_kinect_scene

PRESETS = Path(__file__).parents[3] / "configs" / "refine-kinect"


@functools.cache
def sample(kind="foreground", seed=1, width=240, height=180) -> KinectSample:
    color, truth = make_kinect_scene(kind, seed, width, height, 40)
    return simulate_kinect(color, truth, seed)


def preset(name: str, **fields):
    config = yaml.safe_load((PRESETS / f"{name}.yaml").read_text())
    return Family.of("depthcli.methods.kinect.pipeline").parse(config | fields)


def errors(result, kinect: KinectSample) -> dict[str, float]:
    off = np.abs(RgbdFrame.fb / result.depth.values - kinect.truth)
    return {name: float(off[getattr(kinect, name)].mean()) for name in ("gap", "mismatch", "measured")}


def raw(kinect: KinectSample, name: str) -> float:
    return float(np.abs(kinect.disparity - kinect.truth)[getattr(kinect, name)].mean())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["foreground", "planes"])
def test_gaps_are_filled_edges_moved_and_noise_is_less(kind):
    kinect = sample(kind)
    found = errors(Dsrm()(kinect.frame()), kinect)
    assert found["gap"] < 1.5
    assert found["mismatch"] < 0.46 * raw(kinect, "mismatch")
    assert found["measured"] < raw(kinect, "measured")


def test_leaving_out_unreliable_pixels_is_better_than_the_plain_method():
    kinect = sample()
    best, plain = (errors(preset(name)(kinect.frame()), kinect) for name in ("dsrm", "dsrm-plain"))
    assert best["gap"] < plain["gap"] and best["mismatch"] < plain["mismatch"]


def test_depth_guidance_separates_near_and_far_of_one_color():
    kinect = sample("camouflage", 0)
    guided = errors(Dsrm()(kinect.frame()), kinect)
    blind = Dsrm.model_validate(
        {"segmentation": {"method": "statistical_region_merging", "complexity": 8192, "coarser": [2048, 512],
                          "depth_guidance": 0, "smoothing": 0}}
    )  # fmt: skip
    assert guided["measured"] < 0.7 * errors(blind(kinect.frame()), kinect)["measured"]


def test_the_preset_is_the_default():
    assert preset("dsrm") == Dsrm()


@pytest.mark.parametrize("name", ["dsrm", "dsrm-plain"])
def test_status_says_what_was_done(name):
    frame = sample().frame()
    result = preset(name)(frame)
    depth, status = result.depth.values, result.depth.status
    known = ~np.isnan(frame.depth)
    filled = (status & (DepthStatus.GAP_FILLED | DepthStatus.FALLBACK)) != 0
    np.testing.assert_array_equal(filled, ~known)
    kept = status == DepthStatus.KEPT
    np.testing.assert_array_equal(depth[kept], frame.depth[kept])
    assert (status[known] & ~(DepthStatus.CORRECTED | DepthStatus.SMOOTHED) == 0).all()
    assert (status & DepthStatus.CORRECTED).any()
    assert (depth[known & ~kept] != frame.depth[known & ~kept]).mean() > 0.99
    assert np.isfinite(depth).all() and (depth > 0).all()
    assert np.isfinite(result.sigma).all() and (result.sigma > 0).all()
    assert {"segmentation", "refinement"} <= set(result.seconds)


@pytest.mark.parametrize("name", ["dsrm", "dsrm-plain"])
def test_same_bytes_at_any_number_of_threads_and_inputs_untouched(name):
    kinect = sample()
    frame = kinect.frame()
    color, depth = frame.color.copy(), frame.depth.copy()
    results = []
    for threads in (1, 2, 1):
        set_threads(threads)
        results.append(preset(name)(frame))
    for result in results[1:]:
        assert result.depth.values.tobytes() == results[0].depth.values.tobytes()
        assert result.depth.status.tobytes() == results[0].depth.status.tobytes()
        assert result.sigma.tobytes() == results[0].sigma.tobytes()
    np.testing.assert_array_equal(frame.color, color)
    np.testing.assert_array_equal(frame.depth, depth)


@pytest.mark.parametrize("name", ["dsrm", "dsrm-plain"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (12, 17)])
@pytest.mark.parametrize("known", [1, 5, None])
def test_tiny_and_sparse_frames(name, shape, known):
    rng = np.random.default_rng(0)
    depth = (2 + rng.random(shape)).astype(np.float32)
    if known is not None:
        depth.ravel()[rng.permutation(depth.size)[known:]] = np.nan
    result = preset(name)(RgbdFrame(rng.integers(0, 256, (*shape, 3)).astype(np.uint8), depth))
    found = result.depth.values
    assert found.shape == shape and (found[~np.isnan(found)] > 0).all()
    np.testing.assert_array_equal(np.isnan(found), result.depth.status == DepthStatus.EMPTY)
    assert not np.isnan(found[~np.isnan(depth)]).any()


@pytest.mark.parametrize("name", ["dsrm", "dsrm-plain"])
def test_textureless_and_flat(name):
    depth = np.full((40, 50), 2.0, np.float32)
    depth[10:20, 10:25] = np.nan
    result = preset(name)(RgbdFrame(np.full((40, 50, 3), 90, np.uint8), depth))
    np.testing.assert_allclose(result.depth.values, 2.0, rtol=1e-5)


@pytest.mark.parametrize("name", ["dsrm", "dsrm-plain"])
def test_nothing_known(name):
    frame = RgbdFrame(np.zeros((8, 9, 3), np.uint8), np.full((8, 9), np.nan, np.float32))
    with pytest.raises(ValueError, match="no pixel"):
        preset(name)(frame)


def test_details_are_the_segments_of_every_layer():
    result = Dsrm(details=True)(sample().frame())
    assert sorted(result.pictures) == ["segments_0", "segments_1", "segments_2"]
    for picture in result.pictures.values():
        assert picture.shape == (180, 240, 3) and picture.dtype == np.uint8
    colors = [len(np.unique(p.reshape(-1, 3), axis=0)) for p in result.pictures.values()]
    assert colors[0] > colors[2] > 1


def test_any_segmentation_will_do():
    kinect = sample()
    other = Dsrm.model_validate({"segmentation": "mean_shift"})
    assert errors(other(kinect.frame()), kinect)["mismatch"] < 0.6 * raw(kinect, "mismatch")
