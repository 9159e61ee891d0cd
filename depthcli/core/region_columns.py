"""Columns of a report that are of one region of a scene, such as ``region_95_liver``: what they are called."""

from __future__ import annotations

import re

MEAN, QUANTILE, VOLUME = "region_mean", "region_95", "region_volume"
FIGURES = (MEAN, QUANTILE, VOLUME)
"""Figures of a region; their columns have its name behind them."""

ERROR = "region_error"
"""Why the mask of a region cannot be used; its column has the name of the mask behind it."""

_FIGURE = re.compile(rf"(?P<figure>{'|'.join(FIGURES)})(?:_(?P<region>.+))?")


def region_column(figure: str, region: str = "") -> str:
    """Return the column of a figure of a region; without a region, what the columns of all regions begin with."""
    return f"{figure}_{region}"


def figure_and_region(column: str) -> tuple[str, str] | None:
    """Return the figure and the region that a column is of, or empty for every region; None for other columns."""
    found = _FIGURE.fullmatch(column)
    return (found["figure"], found["region"] or "") if found else None
