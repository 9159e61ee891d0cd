"""Golden accuracy on real scenes: what was measured once must not get worse unnoticed.

Middlebury, bad > 1 px, missing counts as bad. A figure that improves is welcome: lower the golden one.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from depthcli.batch.presets import find_config
from depthcli.core.config_file import load_config
from depthcli.core.frames import StereoPair
from depthcli.evaluation.metrics import kitti, middlebury_v2
from depthcli.io.scenes import find_scenes
from depthcli.stereo.config import StereoConfig
from depthcli.kernels.winners import winners
from depthcli.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.stereo.aggregation.constant_window import ConstantWindow
from depthcli.stereo.aggregation.cross import Cross
from depthcli.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.stereo.cost.combined import Combined
from depthcli.stereo.pipeline.opencv_bm import OpencvBm
from depthcli.stereo.pipeline.opencv_sgbm import OpencvSgbm

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
V2 = "middlebury_v2"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (DATA / V2).is_dir(), reason="Middlebury v2 is not in ../shared/data"),
]

AD_CENSUS = Combined.model_validate(
    {"parts": [{"cost": "absolute_difference", "lambda": 10}, {"cost": "census", "lambda": 30}]}
)


@cache
def scenes(folder=V2):
    if not (DATA / folder).is_dir():
        pytest.skip(f"{folder} is not in ../shared/data")
    found = {scene.name: scene for scene in find_scenes(DATA / folder)}
    return {name: (StereoPair(*s.load_pair()), s.load_truth(), s.max_disparity) for name, s in found.items()}


def errors(values, truth):
    """nonocc, all, disc."""
    scores = middlebury_v2(values.astype(np.float32), truth.disparity, truth.masks, (1.0,))
    by_mask = {score.mask: score.value for score in scores if score.metric == "bad"}
    return [by_mask[mask] for mask in ("nonocc", "all", "disc")]


@pytest.mark.parametrize(
    ("peer", "golden"),
    [
        pytest.param(OpencvSgbm(), 11.2, id="sgbm"),
        pytest.param(OpencvSgbm(mode="3way", wls={}), 9.2, id="sgbm-wls"),
        pytest.param(OpencvBm(), 15.0, id="bm"),
    ],
)
def test_peers_have_their_known_error(peer, golden):
    """Both ways: a peer that we run worse than it is would make our own figures look good."""
    rates = [errors(peer(pair, most).disparity.values, truth) for pair, truth, most in scenes().values()]
    assert np.mean(rates) == pytest.approx(golden, abs=0.4)


@pytest.mark.parametrize(
    ("cost", "aggregate", "golden"),
    [
        pytest.param(AbsoluteDifference(), ConstantWindow(window=11), 12.3, id="ad-cw"),
        pytest.param(AD_CENSUS, ConstantWindow(window=11), 6.1, id="ad-census-cw"),
        pytest.param(AD_CENSUS, Cross(iterations=1, support="intersection"), 3.3, id="ad-census-cross"),
        pytest.param(AD_CENSUS, AdaptiveWeight(window=15), 3.9, id="ad-census-aw15"),
    ],
)
def test_aggregation_without_refinement(cost, aggregate, golden):
    """A point of figure 3.3: winner-takes-all, non-occluded."""
    rates = []
    for pair, truth, most in scenes().values():
        rates.append(errors(winners(aggregate(cost(pair, most + 1), pair).costs)[0], truth)[0])
    assert np.mean(rates) <= golden + 0.2


@pytest.mark.parametrize(
    ("preset", "folder", "most"),
    [
        ("fast", V2, 7.8),
        ("cross", V2, 5.2),
        ("ad-census", V2, 4.8),
        ("adaptive-weight", V2, 6.0),
        ("accurate", V2, 5.8),
        ("accurate", "middlebury_2001", 1.2),
        ("accurate", "middlebury_2005", 10.0),
        ("accurate", "middlebury_2006", 7.0),
    ],
)
def test_presets_keep_their_accuracy(preset, folder, most):
    """Mean of nonocc, all and disc over the scenes of a data set."""
    pipeline = load_config(StereoConfig, find_config("stereo", preset)).pipeline
    found = scenes(folder).values()
    rates = [errors(pipeline(pair, top).disparity.values, truth) for pair, truth, top in found]
    assert np.mean(rates) <= most


def test_accurate_beats_sgbm_on_a_street():
    """D1 over the visible pixels of a KITTI frame; both maps are dense."""
    if not (DATA / "kitti").is_dir():
        pytest.skip("KITTI is not in ../shared/data")
    scene = next(s for s in find_scenes(DATA / "kitti") if s.name == "2012_000070_10")
    pair, truth = StereoPair(*scene.load_pair()), scene.load_truth()

    def d1(pipeline):
        values = pipeline(pair, scene.max_disparity).disparity.values
        scores = kitti(values, truth.disparity, truth.masks)
        return next(s.value for s in scores if (s.metric, s.mask) == ("D1", "noc"))

    ours = d1(load_config(StereoConfig, find_config("stereo", "accurate")).pipeline)
    assert ours <= 5.9
    assert ours < d1(OpencvSgbm()) - 1
