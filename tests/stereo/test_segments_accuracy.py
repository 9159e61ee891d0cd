"""Golden accuracy of the segment-based presets: what was measured once must not get worse unnoticed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.batch.presets import find_config
from depthcli.core.config_file import load_config
from depthcli.core.frames import StereoPair
from depthcli.evaluation.metrics import middlebury_v2
from depthcli.io.scenes import find_scenes
from depthcli.stereo.config import StereoConfig
from depthcli.synthetic.stereo_scenes import make_scene

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
pytestmark = pytest.mark.slow


def _pipeline(name):
    return load_config(StereoConfig, find_config("stereo", name)).pipeline


def _mean_error(name, folder):
    """Mean of nonocc, all and disc over the scenes of a data set, bad > 1 px."""
    if not (DATA / folder).is_dir():
        pytest.skip(f"{folder} is not in ../shared/data")
    rates = []
    for scene in find_scenes(DATA / folder):
        truth = scene.load_truth()
        values = _pipeline(name)(StereoPair(*scene.load_pair()), scene.max_disparity).disparity.values
        scores = middlebury_v2(values, truth.disparity, truth.masks, (1.0,))
        rates += [s.value for s in scores if s.metric == "bad"]
    return np.mean(rates)


@pytest.mark.parametrize(
    ("folder", "most"), [("middlebury_v2", 4.5), ("middlebury_2001", 1.7), ("middlebury_2005", 10.0)]
)
def test_segments_keeps_its_accuracy(folder, most):
    assert _mean_error("segments", folder) <= most


def test_dedc_is_better_than_matching_costs():
    """Table 2.1: what the DEDC data term brings, over all four scenes."""
    assert _mean_error("segments-dedc", "middlebury_v2") < _mean_error("segments-baseline", "middlebury_v2") - 0.3


@pytest.mark.parametrize(
    ("kp", "without", "part"), [("segments-kp", "segments-baseline", 0.6), ("segments", "segments-dedc", 0.75)]
)
def test_key_points_help_where_patterns_repeat(kp, without, part):
    errors = {kp: 0.0, without: 0.0}
    for seed in (0, 2):
        scene = make_scene("repetitive", seed=seed)
        for name in errors:
            values = _pipeline(name)(StereoPair(scene.left, scene.right), scene.max_disparity).disparity.values
            errors[name] += np.mean(~(np.abs(values - scene.disparity_left) <= 1)[scene.nonocc])
    assert errors[kp] <= part * errors[without]
