"""Golden accuracy of the segment-based presets: what was measured once must not get worse unnoticed."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.config_file import load_config
from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.config import StereoConfig
from depthcli.run.presets import find_config
from depthcli.simulate.stereo_scenes import make_scene
from tests.scenes import rates, real_scenes

pytestmark = pytest.mark.slow


def _pipeline(name):
    return load_config(StereoConfig, find_config("stereo", name)).pipeline


def _mean_error(name, folder):
    """Mean of nonocc, all and disc over the scenes of a data set, bad > 1 px."""
    pipeline = _pipeline(name)
    found = real_scenes(folder).values()
    return np.mean([[*rates(pipeline(pair, top).disparity.values, truth).values()] for pair, truth, top in found])


@pytest.mark.parametrize(
    ("folder", "max_error"), [("middlebury_v2", 4.5), ("middlebury_2001", 1.7), ("middlebury_2005", 10.0)]
)
def test_segments_keeps_its_accuracy(folder, max_error):
    assert _mean_error("segments", folder) <= max_error


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
