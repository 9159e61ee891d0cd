"""Folders of small files, as people and data sets have them."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.images import write_png


def laid(folder: Path, files: dict[str, Any]) -> Path:
    """Write files, name -> what they hold, and return the folder: text, bytes, values of JSON, and arrays.

    An array is a map in a .pfm, itself in a .npy, and a PNG under every other name.
    """
    for name, held in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(held, str | bytes):
            path.write_bytes(held.encode() if isinstance(held, str) else held)
        elif not isinstance(held, np.ndarray):
            path.write_text(json.dumps(held))
        elif path.suffix == ".npy":
            np.save(path, held)
        else:
            (write_pfm if path.suffix == ".pfm" else write_png)(path, held)
    return folder
