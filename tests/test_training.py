"""Tables of errors as the scripts that train make them."""

import numpy as np
from _experiments import real_scenes
from _training import table
from train_confidence import training_scenes

from tests.scenes import DATA


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
