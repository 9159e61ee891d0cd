"""Options that may be given for one run as ``NAME=VALUE``: how its maps are named and coded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TypeVar

from depthcli.core.errors import ConfigError

ValueT = TypeVar("ValueT")


def by_run(
    option: str, texts: Sequence[str], runs: Mapping[str, Path], parse: Callable[[str], ValueT]
) -> tuple[ValueT | None, dict[str, ValueT]]:
    """Return the value for all runs, or None, and run -> value of those that have their own.

    Parameters
    ----------
    option : named in messages
    texts : each ``VALUE``, or ``NAME=VALUE``
    runs : name -> place
    parse : makes a value of a text, or raises ValueError with what is wanted

    Raises
    ------
    ConfigError
        Not such a value, no run of that name, or two values for one.
    """
    made: dict[str, ValueT] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if equals and name not in runs:
            raise ConfigError(f"{option} {text}: no run is called {name!r}; one of: {', '.join(runs)}")
        name, value = (name, value) if equals else ("", text)
        if name in made:
            raise ConfigError(f"{option}: two values for {name or 'all runs'}")
        try:
            made[name] = parse(value)
        except ValueError as error:
            raise ConfigError(f"{option}: {error} (got {value!r})") from None
    return made.pop("", None), made


def pattern_of(text: str) -> str:
    """Return the pattern of a run's maps, such as ``{scene}/disparity.tiff``; ValueError where it is none."""
    rest, path = text.replace("{scene}", ""), PurePosixPath(text)
    if not text or "{" in rest or "}" in rest or path.is_absolute() or ".." in path.parts or not path.suffix:
        raise ValueError("want the path of a scene's map in the run folder, such as '{scene}/disparity.tiff'")
    return str(path)


def number_of(text: str) -> float:
    """Return a number, nan among them; ValueError where it is none."""
    try:
        return float(text)
    except ValueError:
        raise ValueError("want a number") from None


def positive(text: str) -> float:
    """Return a number from 1e-6 on; ValueError where it is none."""
    value = number_of(text)
    if not 1e-6 <= value < float("inf"):
        raise ValueError("want a number from 1e-6 on")
    return value
