"""Data sets whose kinds of file lie in folders of the same structure."""

from __future__ import annotations

from pathlib import Path


def files_below(place: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the files with these endings in a folder and below it, sorted, but for hidden ones."""
    return sorted(path for path in place.rglob("[!.]*") if path.suffix.lower() in suffixes and path.is_file())


def existing(path: Path) -> Path | None:
    """Return the path where there is such a file, else None."""
    return path if path.is_file() else None
