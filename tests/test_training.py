"""Scripts that train and choose settings: no scene that is learned from is judged on; few errors make a table."""

from typing import Any

import cv2
import numpy as np
import pytest
from _experiments import GROUPS, generated_scenes, real_scenes, scenes_in
from _training import table
from train_confidence import training_scenes

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


def test_bounds_of_few_landmarks_are_closer_to_the_truth_by_bins_that_overlap():
    asked, spread, shares = np.linspace(-1.8, -0.2, 33, dtype=np.float32), 0.7, np.linspace(0, 1, 17)
    off: dict[float, list[float]] = {0: [], 0.15: []}
    for seed in range(20):
        rng, maps = np.random.default_rng(seed), []
        for k in range(6):  # of three patients; log2 of an error: minus the score, and noise
            score = rng.uniform(-2, 0, 26).astype(np.float32)
            maps.append((f"patient {k // 2}", {"score": score, "error": np.exp2(rng.normal(-score, spread))}))
        for reach, errors in off.items():
            bound = table(maps, "score", shares, 3, 0, reach=reach).bound(asked, 0.9)
            assert (np.diff(bound) <= 0).all()
            errors.append(float(np.log2(bound).mean() - (spread * 1.2816 - asked).mean()))
    bias, overlapping = (np.mean(errors) for errors in off.values())
    assert bias < -0.15, "quantiles of a handful of errors are too small"
    assert abs(overlapping) < 0.1


def test_the_networks_that_judge_maps_learn_from_no_validation_scene():
    taught = {scene.name for scene in training_scenes(DATA)}
    judged = [f"{folder}_{scene.name}_" for folder, scene in real_scenes(DATA, "validation")]
    assert taught and not [name for name in taught if name.startswith(tuple(judged))]
