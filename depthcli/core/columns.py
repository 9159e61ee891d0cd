"""What the columns of tables mean: a name, a unit and one line for each."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class ColumnHelp:
    """The explanation of a column."""

    name: str  # the heading; of columns that differ in a number or name, with that in capitals, such as ``bad T``
    about: str  # one line: what the numbers are of
    unit: str = ""
    also: tuple[str, ...] = ()  # other headings of the same numbers, such as that of the printed table
    pattern: str = ""  # regular expression of all headings, where ``name`` stands for several

    @property
    def headings(self) -> str:
        """Name, other headings and unit, as a list of columns shows them."""
        unit = f" [{self.unit}]" if self.unit else ""
        return ", ".join((self.name, *self.also)) + unit

    def fits(self, heading: str) -> bool:
        """Return whether a column is meant, by its heading without a unit behind a comma."""
        return heading in (self.name, *self.also) or bool(self.pattern and re.fullmatch(self.pattern, heading))


def find_column(columns: Iterable[ColumnHelp], heading: str) -> ColumnHelp | None:
    """Return the first explanation that fits a heading; None where there is none.

    The heading may have a unit behind a comma, or a number of scenes, as ``(2 of 3)``.
    """
    plain = re.sub(r" \(\d+ of \d+\)$", "", heading)
    columns, names = tuple(columns), dict.fromkeys((heading, plain, plain.rpartition(", ")[0] or plain))
    return next((column for name in names for column in columns if column.fits(name)), None)
