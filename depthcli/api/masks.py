"""The option ``--mask``: which pixels of a map become depth or points."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError, InputError


def parse_mask(text: str) -> tuple[str, float, str]:
    """Return kind, share and name of ``measured``, ``all`` or ``confident:0.8:NAME``; ConfigError for other texts."""
    kind, _, rest = text.partition(":")
    share, _, name = rest.partition(":")
    try:
        number = float(share or "nan")
    except ValueError:
        number = -1.0
    if (kind in ("measured", "all") and not rest) or (kind == "confident" and 0 < number <= 1):
        return kind, number, name
    raise ConfigError(f"--mask: must be measured, all, or confident:0.8 (got {text!r})")


def masked(
    text: str,
    known: NDArray[np.bool_],
    filled: NDArray[np.bool_],
    confidence: Mapping[str, Callable[[], NDArray[np.float32]]],
    place: str = "",
) -> NDArray[np.bool_]:
    """Return the pixels that ``--mask`` chooses; of the confident ones all at and above the quantile.

    Parameters
    ----------
    known, filled : (H, W), pixels with a value, and those of them that were not measured
    confidence : name -> function that returns a map, (H, W) float32, higher is surer
    place : what an error begins with

    Raises
    ------
    InputError
        There is no confidence map of that name, or none is named and there are several.
    """
    kind, share, name = parse_mask(text)
    if kind == "all":
        return known
    measured = known & ~filled
    if kind == "measured":
        return measured
    names = ", ".join(confidence)
    if not name and len(confidence) == 1:
        name = names
    if name not in confidence:
        has = f"the run has: {names}" if names else "the run has none; see confidence: in the config"
        raise InputError(f"{place}--mask {text}: which confidence map? {has}")
    values = confidence[name]()
    measured &= np.isfinite(values)
    if measured.any():
        measured &= values >= np.quantile(values[measured], 1 - share, method="higher")
    return measured
