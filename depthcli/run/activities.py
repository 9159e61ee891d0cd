"""What the processes of a run are doing, in memory that they share.

Each scene that is computed has a slot of a :class:`Board`; the process that computes it writes there, through an
:class:`Announcer`, and the process that shows progress reads it now and then. There are no locks, which a worker that
is killed would keep: what is read while it is written may be half of each.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from depthcli.core.progress import Activity, listening

if TYPE_CHECKING:
    from depthcli.kernels.jit import CompileWatch

_SLOT = struct.Struct("<4B4i48s24s")  # begun, compiling; numbers; names of stage and unit


class Running(NamedTuple):
    """A scene that is being computed.

    Attributes
    ----------
    scene : its name
    activity : its stage
    compiling : a kernel is being compiled
    kernels : how many this process has compiled, the present one included
    expected : how many there will be in the end, at a guess; 0 where nothing is known
    """

    scene: str
    activity: Activity
    compiling: bool = False
    kernels: int = 0
    expected: int = 0


class Board:
    """What is done for several scenes at a time.

    Parameters
    ----------
    memory : zeros, :meth:`size` bytes: a bytearray, or an array that processes share
    """

    def __init__(self, memory: Any) -> None:
        self.memory = memory
        self._scenes: dict[int, str] = {}

    @staticmethod
    def size(n_scenes: int) -> int:
        """Return the bytes for so many scenes at a time."""
        return n_scenes * _SLOT.size

    def add(self, scene: str) -> int:
        """Return the number of a free slot, which is now that of ``scene``."""
        slot = next(k for k in range(len(self.memory) // _SLOT.size) if k not in self._scenes)
        self._scenes[slot] = scene
        return slot

    def remove(self, slot: int) -> None:
        """Free a slot, also one whose process is no more."""
        del self._scenes[slot]
        clear(self.memory, slot)

    def running(self) -> list[Running]:
        """Return the scenes that were begun, in the order in which they were added."""
        found = []
        for slot, scene in list(self._scenes.items()):
            begun, compiling, _, _, number, total, kernels, expected, stage, unit = _SLOT.unpack_from(
                self.memory, slot * _SLOT.size
            )
            if begun:
                activity = Activity(_text(stage), _text(unit), number, total)
                found.append(Running(scene, activity, bool(compiling), kernels, expected))
        return found


def clear(memory: Any, slot: int) -> None:
    """Say that the scene of this slot is not being computed."""
    _SLOT.pack_into(memory, slot * _SLOT.size, *(0,) * 8, b"", b"")


class Announcer:
    """Writes what this process does into the slot of the scene that it computes.

    Parameters
    ----------
    memory : of the board
    preset : ``command/name``, whose kernels are counted where some have to be compiled; "" where it is none
    """

    def __init__(self, memory: Any, preset: str) -> None:
        self._memory, self._preset = memory, preset
        self._slot: int | None = None
        self._activity = Activity()
        self._compiling, self._kernels, self._expected = False, 0, 0

    @contextlib.contextmanager
    def scene(self, slot: int) -> Iterator[None]:
        """Write into this slot, meanwhile."""
        self._slot = slot
        try:
            self._stage(Activity())
            with listening(self._stage):
                yield
        finally:
            self._slot = None
            clear(self._memory, slot)

    def compiling(self, watch: CompileWatch) -> None:
        """Take notice of a compilation that begins or ends."""
        self._compiling, self._kernels = watch.busy, watch.calls
        self._write()

    def _stage(self, activity: Activity) -> None:
        self._activity = activity
        self._write()

    def _write(self) -> None:
        if self._slot is not None:
            stage, unit, number, total = self._activity
            expected = max(self._expected, self._kernels) if self._expected else 0
            _SLOT.pack_into(
                self._memory, self._slot * _SLOT.size, True, self._compiling, 0, 0, number, total, self._kernels,
                expected, stage.encode(), unit.encode(),
            )  # fmt: skip


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="replace")
