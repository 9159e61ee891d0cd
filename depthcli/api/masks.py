"""Choices of pixels of a map: those that get a depth, or become points."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.maps import DepthMap, MatchedMap

Pixels = str | NDArray[np.bool_]
"""Name of a choice of pixels, or (H, W) bool."""


def parse_mask(text: str) -> tuple[str, float, str]:
    """Return kind, share and name of a mask as :func:`chosen_pixels` takes it; ConfigError for other texts."""
    kind, _, rest = text.partition(":")
    share, _, name = rest.partition(":")
    try:
        number = float(share or "nan")
    except ValueError:
        number = -1.0
    if (kind in ("measured", "all") and not rest) or (kind == "confident" and 0 < number <= 1):
        return kind, number, name
    raise ConfigError(f"mask: must be measured, all, or confident:0.8 (got {text!r})")


def chosen_pixels(
    found: MatchedMap | DepthMap, mask: Pixels, confidence: Mapping[str, NDArray[np.float32]] | None = None
) -> NDArray[np.bool_]:
    """Return the pixels of a map that a mask chooses, (H, W) bool.

    ``confident:0.8:NAME`` chooses those of the measured ones at and above the quantile of a confidence; the name may be
    left out where there is one only. ConfigError for other texts; InputError for an array of another shape or dtype,
    and where no confidence has that name, or none is named and there are several.
    """
    if not isinstance(mask, str):
        if np.shape(mask) != found.values.shape or np.asarray(mask).dtype != np.bool_:
            raise InputError(f"mask: expected bool of shape {found.values.shape}, got {np.shape(mask)}")
        return mask
    kind, share, name = parse_mask(mask)
    measured = found.valid & ~found.filled
    if kind != "confident":
        return measured if kind == "measured" else found.valid
    maps = confidence or {}
    name = name or (next(iter(maps)) if len(maps) == 1 else "")
    if name not in maps:
        raise InputError(f"mask {mask}: which confidence map? there are: {', '.join(maps) or 'none'}")
    measured &= np.isfinite(maps[name])
    if measured.any():
        measured &= maps[name] >= np.quantile(maps[name][measured], 1 - share, method="higher")
    return measured
