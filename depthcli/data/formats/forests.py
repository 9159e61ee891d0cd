"""Trained random forests as plain arrays in a ``.npz``: nothing in such a file can run."""

from __future__ import annotations

import json
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.data.formats.atomic import atomic_path
from depthcli.data.formats.files import naming, open_regular

_FORMAT = "depthcli forest 1"
_MOST_NODES = 1 << 26
_TYPES = {"roots": "i4", "feature": "i4", "left": "i4", "right": "i4", "threshold": "f8", "value": "f4"}


@dataclass(frozen=True)
class Forest:
    """Regression trees, all nodes of all of them one after another.

    Attributes
    ----------
    measures : names of the columns that ``feature`` counts
    settings : how they are made: what a config must say for the forest to fit it
    trained_on : names of the scenes
    roots : (T,) int32, first node of every tree
    feature : (N,) int32, column that a node looks at; -1: a leaf
    threshold : (N,) float64; ``left`` where the column is at most that, else ``right``, (N,) int32, larger than N's own
    value : (N,) float32, what a leaf says
    """

    measures: tuple[str, ...]
    settings: dict[str, Any]
    trained_on: tuple[str, ...]
    roots: NDArray[np.int32]
    feature: NDArray[np.int32]
    threshold: NDArray[np.float64]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    value: NDArray[np.float32]


def write_forest(path: Path, forest: Forest) -> None:
    """Write a forest; the same bytes for the same forest."""
    head = {"format": _FORMAT, "measures": forest.measures, "settings": forest.settings, "trained": forest.trained_on}
    arrays = {name: getattr(forest, name).astype(f"<{kind}") for name, kind in _TYPES.items()}
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, head=np.array(json.dumps(head, sort_keys=True)), **arrays)


def read_forest(path: Path) -> Forest:
    """Read a forest that :func:`write_forest` wrote.

    Raises
    ------
    InputError
        There is no such file, or it holds something else or damaged trees: walks through what is returned end.
    """
    with naming(path):
        arrays = _arrays(path)
        try:
            head = json.loads(str(arrays.pop("head")))
            said = head["format"], head["measures"], head["settings"], head["trained"]
        except (KeyError, TypeError, ValueError):
            raise InputError(f"not a forest that depthcli wrote ({_FORMAT})") from None
        if said[0] != _FORMAT or not (isinstance(said[1], list) and isinstance(said[2], dict)):
            raise InputError(f"format {str(said[0])[:40]!r}, want {_FORMAT!r}")
        forest = Forest(tuple(map(str, said[1])), said[2], tuple(map(str, said[3])), **arrays)
        _check(forest)
    return forest


def _arrays(path: Path) -> dict[str, Any]:
    with open_regular(path) as file:
        try:
            with zipfile.ZipFile(file) as names:
                if sum(info.file_size for info in names.infolist()) > 32 * _MOST_NODES:
                    raise InputError("too large for a forest")
            file.seek(0)
            with np.load(file, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in ("head", *_TYPES)}
        except (ValueError, KeyError, OSError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error):
            raise InputError(f"not a forest that depthcli wrote ({_FORMAT})") from None
    for name, kind in _TYPES.items():
        if arrays[name].ndim != 1 or arrays[name].dtype != np.dtype(f"<{kind}"):
            raise InputError(f"damaged: {name} has another type")
    return arrays


def _check(forest: Forest) -> None:
    nodes = np.arange(len(forest.feature))
    inner = forest.feature >= 0
    same = all(len(getattr(forest, name)) == len(nodes) for name in _TYPES if name != "roots")
    if not same or not len(forest.roots) or not len(nodes):
        raise InputError("damaged: the arrays differ in length, or are empty")
    ends = np.concatenate([forest.left[inner], forest.right[inner], forest.roots])
    forward = (forest.left[inner] > nodes[inner]).all() and (forest.right[inner] > nodes[inner]).all()
    if not forward or ends.min() < 0 or ends.max() >= len(nodes) or forest.feature.max() >= len(forest.measures):
        raise InputError("damaged: branches that lead nowhere")
    if not (np.isfinite(forest.threshold).all() and np.isfinite(forest.value).all()):
        raise InputError("damaged: values that are no numbers")
