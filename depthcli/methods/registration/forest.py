"""Measures to millimeters by a random forest trained on registrations whose errors are known.

Follow-up of the thesis' chapter 7: measures of the search as the features of a random forest (Breiman, Machine Learning
2001) that predicts the error in mm. scikit-learn is an extra and only needed to train: a trained forest is arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError
from depthcli.data.formats.forests import Forest
from depthcli.kernels.jit import parallel_jit, prange

_ROWS = 1 << 16  # voxels that are walked at once
_TREES, _LEAST = 200, 3


def train(
    table: Mapping[str, NDArray[np.float32]],
    error: NDArray[np.float32],
    settings: Mapping[str, Any],
    trained_on: Sequence[str],
    seed: int = 0,
    jobs: int = 1,
) -> Forest:
    """Grow a forest; the same one for a seed at any number of jobs.

    Parameters
    ----------
    table : measure -> (n,)
    error : (n,) mm
    settings : of the config that made the measures, see :class:`~depthcli.data.formats.forests.Forest`
    trained_on : names of the pairs

    Raises
    ------
    ConfigError
        scikit-learn is not installed.
    ValueError
        Fewer than two rows, or columns of other lengths.
    """
    if len(error) < 2 or any(len(column) != len(error) for column in table.values()):
        raise ValueError(f"want columns of one length, 2 or more, got {len(error)} errors")
    try:
        from sklearn.ensemble import RandomForestRegressor
    except ImportError:
        raise ConfigError("training a forest needs scikit-learn: pip install 'depthcli[forest]'") from None
    model = RandomForestRegressor(
        _TREES, min_samples_leaf=_LEAST, max_features=1 / 3, random_state=seed, n_jobs=jobs
    )  # fmt: skip
    model.fit(np.stack(list(table.values()), axis=1).astype(np.float32), error.astype(np.float64))
    trees = [estimator.tree_ for estimator in model.estimators_]
    roots = np.concatenate([[0], np.cumsum([tree.node_count for tree in trees])[:-1]]).astype(np.int32)

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(tree, name).ravel() for tree in trees])

    starts = np.repeat(roots, [tree.node_count for tree in trees])
    leaf = joined("children_left") < 0
    return Forest(
        measures=tuple(table), settings=dict(settings), trained_on=tuple(trained_on), roots=roots,
        feature=np.where(leaf, -1, joined("feature")).astype(np.int32),
        threshold=np.where(leaf, 0, joined("threshold")).astype(np.float64),
        left=np.where(leaf, 0, joined("children_left") + starts).astype(np.int32),
        right=np.where(leaf, 0, joined("children_right") + starts).astype(np.int32),
        value=joined("value").astype(np.float32),
    )  # fmt: skip


def check_forest(forest: Forest, settings: Mapping[str, Any], measures: Sequence[str]) -> None:
    """ConfigError where the forest was trained on other measures, or on measures made otherwise."""
    for name, want in forest.settings.items():
        if name not in settings or settings[name] != want:
            raise ConfigError(f"the forest was trained with {name}: {want}, the config says {settings.get(name)}")
    lacking = [name for name in forest.measures if name not in measures]
    if lacking:
        raise ConfigError(f"the forest was trained on measures that this config does not make: {', '.join(lacking)}")


def predict(forest: Forest, maps: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
    """Mean of the trees, mm, in the maps' shape.

    Parameters
    ----------
    maps : every one of the forest's measures, arrays of one shape
    """
    columns = [maps[name].ravel() for name in forest.measures]
    out = np.empty(columns[0].size, np.float32)
    for first in range(0, out.size, _ROWS):
        table = np.stack([column[first : first + _ROWS] for column in columns], axis=1)
        _walk(
            table, forest.roots, forest.feature, forest.threshold, forest.left, forest.right, forest.value,
            out[first : first + _ROWS],
        )  # fmt: skip
    return out.reshape(maps[forest.measures[0]].shape)


@parallel_jit
def _walk(
    table: Any, roots: Any, feature: Any, threshold: Any, left: Any, right: Any, value: Any, out: Any
) -> None:  # fmt: skip
    """Mean over the trees of the leaf that every row of (n, M) float32 falls into."""
    for i in prange(out.size):
        total = 0.0
        for t in range(roots.size):
            node = roots[t]
            while feature[node] >= 0:
                small = np.float64(table[i, feature[node]]) <= threshold[node]
                node = left[node] if small else right[node]
            total += np.float64(value[node])
        out[i] = np.float32(total / roots.size)
