"""What every member of a family promises, over the files of its folder; and what is said of members that break it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthcli.algorithms.keypoints.sift import Sift
from depthcli.core.method import Family
from depthcli.methods.fusion.choice import ChosenMap
from depthcli.methods.fusion.choice.energy import LeastEnergyChoice
from depthcli.methods.kinect.pipeline.nearest import NearestFill
from depthcli.methods.registration.feature.intensity import Intensity
from depthcli.methods.stereo.pipeline.opencv_bm import OpencvBm
from depthcli.simulate.samples import samples
from depthcli.testing import (
    check_choice,
    check_keypoint_detector,
    check_kinect_pipeline,
    check_sample,
    check_stereo_pipeline,
    check_volume_feature,
    choices,
    features,
    pipelines,
)

FIELDS = {"local": {"cost": "census", "aggregation": {"method": "constant_window", "window": 5}},
          "segments": {"cost": "census"}}  # fmt: skip
NEED_FILES = ("command", "onnx", "network")

CHECKS = {
    "methods.stereo.pipeline": pipelines.STEREO_CHECKS,
    "methods.kinect.pipeline": pipelines.KINECT_CHECKS,
    "methods.transparent.pipeline": pipelines.TRANSPARENT_CHECKS,
    "methods.registration.pipeline": pipelines.REGISTRATION_CHECKS,
    "methods.kinect.model": choices.MODEL_CHECKS,
    "methods.fusion.choice": choices.CHOICE_CHECKS,
    "methods.registration.feature": features.VOLUME_CHECKS,
    "algorithms.keypoints": features.KEYPOINT_CHECKS,
}
MEMBERS = [
    pytest.param(package, name, check, id=f"{package}-{name}-{check.__name__}")
    for package, checks in CHECKS.items()
    for name in Family.of(f"depthcli.{package}").own_names
    if name not in NEED_FILES
    for check in checks
]


@pytest.mark.parametrize(("package", "name", "check"), MEMBERS)
def test_contract(package: str, name: str, check: Callable[[Any], None]):
    family = Family.of(f"depthcli.{package}")
    check(family.parse({family.key: name, **FIELDS.get(name, {})}))


@pytest.mark.parametrize("name", ["stereo", "kinect", "cross_modal", "registration"])
def test_samples(name: str, tmp_path: Path):
    sample = samples()[name]
    small: dict[str, Any] = {"count": 2, "width": 96, "height": 64, "max_disparity": 12}
    check_sample(sample, tmp_path, **{k: v for k, v in small.items() if k in {o.name for o in sample.options}})


class Far(OpencvBm):
    def __call__(self, pair, max_disparity):
        result = super().__call__(pair, max_disparity)
        result.disparity.values[:] += 100
        return result


class Silent(NearestFill):
    def __call__(self, frame):
        result = super().__call__(frame)
        result.depth.status[:] = 0
        return result


class Other(LeastEnergyChoice):
    def __call__(self, proposals):
        return ChosenMap(np.zeros_like(proposals.values[0]) - 1)


class Weak(Sift):
    def __call__(self, image):
        points = super().__call__(image)
        return replace(points, descriptors=2 * points.descriptors)


class Signed(Intensity):
    def __call__(self, fixed, warped):
        one, other = super().__call__(fixed, warped)
        return one.astype(np.int8), other.astype(np.int8)


@pytest.mark.parametrize(("check", "wrong", "said"), [
    (check_stereo_pipeline, Far(), "Far fails a_plane_has_its_disparity"),
    (check_kinect_pipeline, Silent(), "Silent fails gaps_are_filled .*want GAP_FILLED, FALLBACK or EMPTY"),
    (check_choice, Other(), "Other fails values_lie_between_the_proposals .* none that was proposed"),
    (check_keypoint_detector, Weak(), "Weak fails points_move_with_the_image .* want length 1"),
    (check_volume_feature, Signed(), "Signed fails same_channels_at_any_number_of_threads .* want uint8, got int8"),
])  # fmt: skip
def test_what_is_wrong_is_named(check: Callable[[Any], None], wrong: Any, said: str):
    with pytest.raises(AssertionError, match=f"(?s){said}"):
        check(wrong)
