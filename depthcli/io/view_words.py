"""Words in names of files that say which view an image is."""

from __future__ import annotations

import re

SIDES = re.compile(r"(?<![a-z])(?:(left|l)|(right|r))(?![a-z])", re.IGNORECASE)
"""Words of a name that say which view it is."""


def without_word(name: str, word: re.Pattern[str] | None) -> str:
    """Return a name or path without what ``word`` matches, and without what parted it from the rest."""
    parts = (word.sub("", name) if word else name).split("/")
    plain = (re.sub(r"[-_. ]{2,}", "_", part).strip("-_. ") for part in parts)
    return "/".join(part for part in plain if part)
