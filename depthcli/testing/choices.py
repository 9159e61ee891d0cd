"""What every choice among maps, and every model of surfaces, promises."""

from __future__ import annotations

import numpy as np

from depthcli.methods.fusion.choice import ChoiceMethod, Proposals
from depthcli.methods.kinect.model import SurfaceModel
from depthcli.testing.inputs import assert_pure, blocky_pair, random_volume, run_checks

KINDS = ("median", "own", "local", "felzenszwalb")


def check_choice(choice: ChoiceMethod) -> None:
    """Raise AssertionError unless a choice of ``fuse`` keeps what the command relies on."""
    run_checks(choice, CHOICE_CHECKS)


def check_surface_model(model: SurfaceModel) -> None:
    """Raise AssertionError unless a model of the depth in segments keeps what ``refine-kinect`` relies on."""
    run_checks(model, MODEL_CHECKS)


def random_proposals(
    height: int = 9, width: int = 21, n_disparities: int = 12, count: int = 4, seed: int = 0
) -> Proposals:
    """Return ``count`` noisy versions of one random map, called by the names in ``KINDS``, at most 16."""
    rng = np.random.default_rng(seed)
    base = rng.uniform(0, n_disparities - 1, (height, width))
    values = np.clip(base + rng.normal(0, 1.5, (count, height, width)), 0, n_disparities - 1).astype(np.float32)
    return Proposals(
        (KINDS * 4)[:count],
        values,
        rng.integers(0, 3, values.shape).astype(np.uint8),
        np.ones(count, np.float32),
        blocky_pair(height, width, True, seed),
        random_volume(height, width, n_disparities),
        rng.integers(0, n_disparities, (height, width)).astype(np.uint16),
    )


def values_lie_between_the_proposals(choice: ChoiceMethod) -> None:
    """At every pixel the value lies between the least and the largest proposal; probabilities are 0 .. 1."""
    for height, width in ((1, 1), (1, 9), (9, 1), (9, 21)):
        given = random_proposals(height, width)
        chosen = choice(given)
        assert chosen.values.shape == (height, width), f"want {(height, width)}, got {chosen.values.shape}"
        assert chosen.values.dtype == np.float32, f"want float32, got {chosen.values.dtype}"
        low, high = given.values.min(axis=0) - 1e-4, given.values.max(axis=0) + 1e-4
        assert np.all((chosen.values >= low) & (chosen.values <= high)), "a value is none that was proposed"
        if (known := chosen.probability) is not None:
            assert np.all((known >= 0) & (known <= 1)), "a probability is not within 0 .. 1"


def same_choice_at_any_number_of_threads(choice: ChoiceMethod) -> None:
    """The map does not depend on the number of threads, and the proposals stay as they were."""
    given = random_proposals(20, 31, seed=1)
    assert_pure(lambda: choice(given).values, given.values, given.volume.costs, given.right)


def planes_are_fitted(model: SurfaceModel) -> None:
    """Two planes with gaps and noise are fitted within a tenth of a pixel, pixels without a label have no value."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:40, :60]
    labels = (x >= 30).astype(np.int32)
    labels[:3] = -1
    truth = np.where(labels == 1, 20 + 0.05 * x, 40 - 0.1 * y)
    values = (truth + 0.02 * rng.standard_normal(truth.shape)).astype(np.float32)
    values[rng.random(truth.shape) < 0.3] = np.nan
    before = values.copy()
    found = model(values, labels, 0.02).at(labels)
    np.testing.assert_array_equal(values, before, "the values were changed")
    assert np.isnan(found[:3]).all(), "a pixel without a label has a value"
    error = np.abs(found - truth)[3:].max()
    assert error < 0.1, f"the largest error is {error:.2f} pixels"


def same_surfaces_at_any_number_of_threads(model: SurfaceModel) -> None:
    """The surfaces do not depend on the number of threads; a segment of which nothing is known is no error."""
    values = np.random.default_rng(1).uniform(10, 20, (30, 40)).astype(np.float32)
    labels = (np.arange(1200, dtype=np.int32) // 300).reshape(30, 40)
    values[labels == 2] = np.nan
    assert_pure(lambda: model(values, labels, 0.02).at(labels), values, labels)


CHOICE_CHECKS = (values_lie_between_the_proposals, same_choice_at_any_number_of_threads)
MODEL_CHECKS = (planes_are_fitted, same_surfaces_at_any_number_of_threads)
"""One function a promise."""
