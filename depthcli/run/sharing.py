"""Locks and shards for several processes, on one machine or many, that fill one run folder.

A run without ``--shard`` locks its folder against all other processes. The processes of a shared run lock it against
such runs, claim every scene before they compute it, and write one part of the report each; the last one joins them.
"""

from __future__ import annotations

import contextlib
import hashlib
import heapq
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

from depthcli.core.errors import ConfigError, OutputError
from depthcli.io.scenes import Scene
from depthcli.run.command import SceneT

LOCKS_FILE = ".locks"
_SETUP_TIMEOUT = 60.0  # seconds that a process waits for another one to set up the folder
_POLL_SECONDS = 0.05
_REPORT_BYTE = 0  # of the file of locks; locked while the report is written


@dataclass(frozen=True)
class Shard:
    """Part ``index`` of ``count``, from 1."""

    index: int
    count: int

    def __str__(self) -> str:
        return f"{self.index}-of-{self.count}"

    def of(self, scenes: Sequence[SceneT], effort: Callable[[SceneT], int | None] = lambda scene: None) -> list[SceneT]:
        """Return the scenes of this part; every process divides them in the same way.

        Parameters
        ----------
        effort : estimates the computing time of a scene, in any unit; if it is None for one of them, the sizes of
            all scenes' files are used instead
        """
        parts = [(0, number) for number in range(1, self.count + 1)]
        mine = []
        efforts: list[int] = []
        for scene in scenes:
            needs = 0 if scene.problem else effort(scene)
            if needs is None:
                efforts = [_bytes(scene) for scene in scenes]
                break
            efforts.append(needs)
        for size, scene in sorted(zip(efforts, scenes, strict=True), key=lambda pair: (-pair[0], pair[1].name)):
            load, number = heapq.heappop(parts)
            if number == self.index:
                mine.append(scene)
            heapq.heappush(parts, (load + size + 1, number))
        return sorted(mine, key=lambda scene: scene.name)


def parse_shard(text: str | None, environment: Mapping[str, str]) -> Shard | None:
    """Return the shard that ``3/8`` or a job array of Slurm describes; None for a run that is not shared.

    Raises
    ------
    ConfigError
        The part does not exist.
    """
    if text is not None:
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if found is None or not 1 <= int(found[1]) <= int(found[2]):
            raise ConfigError(f"--shard: must be part/parts such as 3/8, from 1/8 to 8/8 (got {text!r})")
        return Shard(int(found[1]), int(found[2]))
    try:
        task, parts = (int(environment[f"SLURM_ARRAY_TASK_{name}"]) for name in ("ID", "COUNT"))
        first, step = (int(environment.get(f"SLURM_ARRAY_TASK_{n}", d)) for n, d in (("MIN", "0"), ("STEP", "1")))
    except (KeyError, ValueError):
        return None
    index = (task - first) // max(step, 1) + 1
    if not 1 <= index <= parts:
        raise ConfigError(f"SLURM_ARRAY_TASK_ID {task} of {parts} tasks do not make a shard; give --shard I/N")
    return Shard(index, parts)


def _bytes(scene: Scene) -> int:
    total = 0
    for file in {} if scene.problem else scene.input_files.values():
        with contextlib.suppress(OSError):
            total += os.stat(file).st_size
    return total


class FolderLock:
    """The right to write into a run folder; the operating system frees it when this process ends.

    The first process of a shared run is ``alone`` and sets the folder up; ``settle`` lets the others in, which waited.
    Each scene is computed between ``claim`` and ``release``. ``last`` tells the process that joins the reports.

    Parameters
    ----------
    output : the folder, made where it is missing
    shared : True where other processes may hold the lock as well, if they share it, too
    warn : takes a message where the file system has no locks

    Attributes
    ----------
    alone : True while no other process can write into the folder: until ``settle``, or to the end
    locks : False on a file system without locks, where nobody knows of other processes
    """

    def __init__(self, output: Path, shared: bool, warn: Callable[[str], None]) -> None:
        self.output, self.shared, self.warn = output, shared, warn
        self.alone, self.locks = False, True
        self._folder = self._scenes = -1
        self._held: set[str] = set()

    def __enter__(self) -> FolderLock:
        try:
            self.output.mkdir(parents=True, exist_ok=True)
            self._folder = os.open(self.output, os.O_RDONLY)
        except OSError as error:
            raise OutputError(f"{self.output}: cannot be used as a run folder ({error.strerror or error})") from error
        try:
            self._lock_folder()
        except BaseException:
            os.close(self._folder)
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._scenes >= 0:
            os.close(self._scenes)
        os.close(self._folder)

    def _lock_folder(self) -> None:
        end = time.monotonic() + (_SETUP_TIMEOUT if self.shared else 0)
        try:
            if fcntl is None:
                raise OSError("no locks on this system")
            while True:
                for kind in (fcntl.LOCK_EX, fcntl.LOCK_SH) if self.shared else (fcntl.LOCK_EX,):
                    with contextlib.suppress(BlockingIOError):
                        fcntl.flock(self._folder, kind | fcntl.LOCK_NB)
                        self.alone = kind == fcntl.LOCK_EX
                        return
                if time.monotonic() > end:
                    raise ConfigError(f"{self.output}: another depthcli is writing there now")
                time.sleep(_POLL_SECONDS)
        except OSError:
            self.alone, self.locks = not self.shared, False
            self.warn(f"{self.output}: no locks on this file system; make sure that no other run writes there")

    def settle(self) -> None:
        """Admit other processes of the same shared run, once the folder is set up."""
        if not self.shared or fcntl is None:
            return
        with contextlib.suppress(OSError):
            if self.alone:
                fcntl.flock(self._folder, fcntl.LOCK_SH)
            self._scenes = os.open(self.output / LOCKS_FILE, os.O_RDWR | os.O_CREAT, 0o666)
        self.alone = not self.shared

    def claim(self, name: str) -> bool:
        """Claim a scene; return False where another process has it."""
        if self._scenes >= 0 and name not in self._held:
            try:
                fcntl.lockf(self._scenes, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _byte(name))
            except (BlockingIOError, PermissionError):
                return False
            except OSError:  # no such locks here: the shards are apart anyway
                return True
            self._held.add(name)
        return True

    def release(self, name: str) -> None:
        """Release a scene."""
        if name in self._held:
            self._held.discard(name)
            with contextlib.suppress(OSError):
                fcntl.lockf(self._scenes, fcntl.LOCK_UN, 1, _byte(name))

    @contextlib.contextmanager
    def reporting(self) -> Iterator[None]:
        """Hold the lock of the joined report."""
        if self._scenes < 0:
            yield
            return
        with contextlib.suppress(OSError):
            fcntl.lockf(self._scenes, fcntl.LOCK_EX, 1, _REPORT_BYTE)
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                fcntl.lockf(self._scenes, fcntl.LOCK_UN, 1, _REPORT_BYTE)

    def last(self) -> bool:
        """Return True where all other processes have left; from then on the folder is locked against new ones."""
        if not self.shared or fcntl is None:
            return not self.shared
        with contextlib.suppress(OSError):
            fcntl.flock(self._folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.alone = True
            (self.output / LOCKS_FILE).unlink(missing_ok=True)
        return self.alone


def _byte(name: str) -> int:
    """Return the byte of the file of locks that stands for a scene."""
    return 1 + int.from_bytes(hashlib.sha256(name.encode("utf-8", "surrogateescape")).digest()[:7], "big")
