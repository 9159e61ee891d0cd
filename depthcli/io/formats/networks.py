"""Trained networks as JSON files, with four digits per number, and error tables as CSV."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.error_table import ErrorTable
from depthcli.algorithms.pixel_network import TrainedNetwork
from depthcli.core.errors import InputError
from depthcli.io.formats.files import atomic_path, naming, read_bytes

_FORMAT = "depthcli choice 1"
_MAX_BYTES = 1 << 24
_SHIPPED = Path(__file__).resolve().parent.parent / "networks"


def network_path(name: str) -> Path:
    """Return the path of a network: ``name`` itself if it ends with .json, otherwise a file of the package."""
    if name.endswith(".json"):
        return Path(name)
    path = _SHIPPED / f"{name}.json"
    if not path.is_file():
        shipped = ", ".join(file.stem for file in sorted(_SHIPPED.glob("*.json")))
        raise InputError(f"no network called {name!r}; expected a .json file or one of the package: {shipped}")
    return path


def read_network(path: Path) -> TrainedNetwork:
    """Return a network from a file of :func:`write_network`."""
    data, numbers = read_bytes(path, _MAX_BYTES), partial(np.array, dtype=np.float32)
    with naming(path):
        try:
            content = json.loads(data)
            if content["format"] != _FORMAT:
                raise InputError(f"format {str(content['format'])[:40]!r}, expected {_FORMAT!r}")
            with np.errstate(over="ignore"):  # TrainedNetwork rejects infinite values
                return TrainedNetwork(
                    tuple(map(str, content["maps"])),
                    tuple(map(str, content["inputs"])),
                    numbers(content["mean"]),
                    numbers(content["scale"]),
                    tuple((numbers(each["weights"]), numbers(each["offsets"])) for each in content["layers"]),
                    tuple(map(str, content["trained_on"])),
                )
        except (LookupError, TypeError, ValueError, OverflowError, RecursionError, AttributeError) as error:
            raise InputError(f"not a network that depthcli wrote ({str(error)[:200]})") from None


def read_numbers(name: str) -> NDArray[np.float64]:
    """Return the rows of numbers in a CSV file of the package."""
    return np.loadtxt(_SHIPPED / f"{name}.csv", delimiter=",", ndmin=2)


def read_errors(name: str) -> ErrorTable:
    """Return an error table of the package, written by ``scripts/train_bounds.py``."""
    rows = read_numbers(name)
    return ErrorTable(rows[1:, 0], rows[0, 1:], rows[1:, 1:])


def write_network(path: Path, network: TrainedNetwork) -> None:
    """Write a network for :func:`read_network`."""

    def rounded(array: NDArray[np.float32]) -> Any:
        return np.vectorize(lambda value: float(f"{value:.4g}"), otypes=[float])(array).tolist()

    content = {
        "format": _FORMAT,
        "trained_on": network.trained_on,
        "maps": network.maps,
        "inputs": network.inputs,
        "mean": rounded(network.mean),
        "scale": rounded(network.scale),
        "layers": [{"weights": rounded(weights), "offsets": rounded(offsets)} for weights, offsets in network.layers],
    }
    text = json.dumps(content, separators=(",", ":"))
    with atomic_path(path) as temporary:
        temporary.write_text(text.replace("],[", "],\n[").replace(',"', ',\n"') + "\n", "utf-8")
