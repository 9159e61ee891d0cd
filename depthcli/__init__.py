"""depthcli: batch stereo matching, depth refinement, fusion, confidence and their evaluation.

``__init__.pyi`` lists the public functions and classes with their modules, which are imported on first use.
"""

import re
from importlib import import_module
from pathlib import Path

__version__ = "0.3.0"

_STUB = Path(__file__).with_suffix(".pyi").read_text("utf-8")
_PLACES = {name: module for module, name in re.findall(r"^from (\S+) import (\w+) as", _STUB, re.MULTILINE)}
__all__ = ["__version__", *_PLACES]


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module 'depthcli' has no attribute {name!r}")
    value = getattr(import_module(_PLACES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
