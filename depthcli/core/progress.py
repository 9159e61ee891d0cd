"""What a computation is doing: announced by whoever does it, for whoever shows it. It never changes a result.

Every stage of a :class:`~depthcli.core.result.Clock` is announced, and the tiles of a pair. Without a listener an
announcement costs less than a microsecond.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sized
from typing import NamedTuple, Protocol, TypeVar

T_co = TypeVar("T_co", covariant=True)


class Activity(NamedTuple):
    """What is done at the moment.

    Attributes
    ----------
    stage : name of the stage, "" before the first one
    unit : what the stage goes through one by one, such as "tile"; "" where there is no such thing
    number, total : the present one, from 1, of how many
    """

    stage: str = ""
    unit: str = ""
    number: int = 0
    total: int = 0


class Countable(Sized, Iterable[T_co], Protocol[T_co]):
    """What can be gone through and has a length."""


Listener = Callable[[Activity], None]
_listener: Listener | None = None
_now = Activity()


@contextlib.contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Call ``listener``, which must return at once, with everything that this process announces meanwhile."""
    global _listener, _now
    earlier, _listener, _now = _listener, listener, Activity()
    try:
        yield
    finally:
        _listener = earlier


def announce_stage(stage: str) -> None:
    """Say that a stage begins."""
    _announce(_now._replace(stage=stage))


def counted(things: Countable[T_co], unit: str) -> Iterator[T_co]:
    """Yield all ``things``, and say of each that it begins where there are several."""
    for number, thing in enumerate(things, 1):
        if len(things) > 1:
            _announce(_now._replace(unit=unit, number=number, total=len(things)))
        yield thing
    _announce(Activity(_now.stage))


def _announce(activity: Activity) -> None:
    global _now
    if _listener is not None:
        _now = activity
        _listener(activity)
