"""The scenes of ``scripts/stereo_groups.yaml``: settings are chosen on some and judged on others."""

from typing import Any

import cv2
import numpy as np
import pytest
from _experiments import GROUPS, generated_scenes, scenes_in

from depthcli.core.frames import StereoPair
from depthcli.simulate.stereo_scenes import make_scene
from tests.scenes import DATA, load, needs_data

SAME = 0.95
"""Thumbnails of one view at another size, crop or exposure correlate by more; other views by less."""


def thumbnail(pair: StereoPair) -> np.ndarray:
    """The left image in grey, 32 x 24 pixels, with mean 0 and length 1."""
    small = cv2.resize(pair.grey8[0].astype(np.float32), (32, 24), interpolation=cv2.INTER_AREA)
    small -= small.mean()
    return small.ravel() / np.linalg.norm(small)


def thumbnails(group: dict[str, Any]) -> dict[str, np.ndarray]:
    """Thumbnails of the real scenes of a group by folder and name."""
    return {
        f"{folder}/{scene.name}": thumbnail(load(scene))
        for folder, names in group.items()
        if folder != "generated"
        for scene in scenes_in(DATA / folder, *names)
    }


def in_both(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> set[tuple[str, str]]:
    return {(a, b) for a, x in one.items() for b, y in other.items() if x @ y > SAME}


@needs_data
def test_no_validation_scene_is_a_tuning_scene():
    tuning = thumbnails(GROUPS["tuning"])
    for folder, names in GROUPS["validation"].items():
        if folder != "generated":
            assert not in_both(thumbnails({folder: names}), tuning), folder
    # A scene of two data sets would be found.
    assert in_both(thumbnails({"middlebury_v3": ["Teddy"]}), tuning) == {("middlebury_v3/Teddy", "middlebury_v2/Teddy")}
    twice = thumbnails({"middlebury_v3": ["Motorcycle", "MotorcycleE"]})
    assert len(in_both(twice, twice)) == 4


@pytest.mark.slow
def test_no_generated_validation_scene_is_a_tuning_scene():
    groups = {
        group: {
            f"{name} {kind} {seed}": thumbnail(StereoPair(made.left, made.right))
            for name, kind, seed, look in generated_scenes(group)
            for made in [make_scene(kind, seed, **look | {"height": 96, "width": 128})]
        }
        for group in GROUPS
    }
    assert not in_both(groups["validation"], groups["tuning"])
