"""Links of Markdown files: which lead nowhere in the repository."""

import os
import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path

CODE = re.compile(r"^(```+).*?^\1[ ]*$|(`+)(?!`)[^\n]*?(?<!`)\2(?!`)", re.M | re.S)
LINK = re.compile(r"\]\((?!https?:|mailto:)<?([^()\s<>]*(?:\([^()\s]*\)[^()\s]*)*)>?\)")
HEADING = re.compile(r"^ {0,3}#{1,6} +(.*?)(?: +#+)?$", re.M)


def links(text: str) -> list[str]:
    """Return the targets of all relative links and pictures of a page, outside of its code."""
    return LINK.findall(CODE.sub("", text))


def anchors(text: str) -> set[str]:
    """Return the names of a page's headings, as code hosts and Sphinx's parser make them."""
    found: set[str] = set()
    without_blocks = re.sub(r"^(```+).*?^\1[ ]*$", "", text, flags=re.M | re.S)
    for heading in HEADING.findall(without_blocks):
        shown = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        name = re.sub(r"[^\w\- ]", "", unicodedata.normalize("NFC", shown)).strip().replace(" ", "-")
        count = sum(each == name or re.fullmatch(re.escape(name) + r"-\d+", each) is not None for each in found)
        found.add(f"{name}-{count}" if count else name)
    return found


def dead_links(root: Path, pages: list[Path]) -> Iterator[str]:
    """Yield ``page: target`` of every link to a file, folder or heading that is not in the repository ``root``."""
    for page in pages:
        for target in links(page.read_text("utf-8")):
            path, _, name = target.partition("#")
            file = Path(os.path.normpath(page.parent / path)) if path else page
            there = file.is_relative_to(root) and file.exists()
            if not there or (name and (file.suffix != ".md" or name not in anchors(file.read_text("utf-8")))):
                yield f"{page.relative_to(root)}: {target}"
