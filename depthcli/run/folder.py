"""Locks of a run folder, for the processes that write into it.

Processes with the same config may share a folder. Each has a shared lock on it. The first process has it alone and sets
the folder up while the others wait. The process that locks a scene's byte in the lock file computes the scene. The
operating system frees all locks of a process when it ends.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from depthcli.core.errors import ConfigError, OutputError
from depthcli.io.formats.files import RECORD_FILE, RUN_FILE, flush, write_text
from depthcli.run.records import (
    CLAIM_FILE,
    REPORT_FILES,
    Record,
    digest,
    digests_below,
    discard,
    hidden_folder,
    install,
    not_ours,
    read_record,
    read_text,
    records_below,
    remove_leftovers,
    remove_results,
)

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LEGEND_FILE = "status.txt"
"""File in the run folder that explains the codes of status maps."""
EVALUATION = "evaluation"
"""Folder in the run folder with scores and page."""
FOLDER_FILES = (RUN_FILE, *REPORT_FILES, LEGEND_FILE, "legend.png", EVALUATION)  # legend.png: versions up to 0.2.0
"""Names in a run folder that no scene may have."""
LOCKS_FILE = ".locks"

_SETUP_TIMEOUT = 60.0  # seconds to wait for another process to set up the folder
_POLL_SECONDS = 0.05
_REPORT = ""  # what is claimed while the report is written

TITLE = "# Written by depthcli: the resolved config of this run."
"""First line of run.yaml; depthcli did not write a run.yaml without it."""


@dataclass(eq=False)
class FolderLock:
    """The right to write into a run folder, which is created if needed.

    It is ``alone`` while no other process can write there: until ``share``, or after ``last`` returned True. ``locks``
    is False on a file system without locks; other processes are unknown there, and ``warn`` gets a message.
    """

    output: Path
    warn: Callable[[str], None]
    alone: bool = False
    locks: bool = fcntl is not None
    _folder: int = -1  # opened
    _scenes: int = -1  # the file of locks, opened

    def __enter__(self) -> FolderLock:
        try:
            self.output.mkdir(parents=True, exist_ok=True)
            if self.locks:  # Windows cannot open folders
                self._folder = os.open(self.output, os.O_RDONLY)
        except OSError as error:
            raise OutputError(f"{self.output}: cannot be used as a run folder ({error.strerror or error})") from error
        try:
            self._wait()
        except BaseException:
            if self._folder >= 0:
                os.close(self._folder)
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self.last()
        finally:
            for each in (self._scenes, self._folder):
                if each >= 0:
                    os.close(each)

    def _wait(self) -> None:
        end = time.monotonic() + _SETUP_TIMEOUT
        while self.locks and not self.alone:
            try:
                if not self._try_lock(fcntl.LOCK_EX):
                    if self._try_lock(fcntl.LOCK_SH):
                        return
                    if time.monotonic() > end:
                        raise ConfigError(f"{self.output}: another depthcli is setting this folder up; try again")
                    time.sleep(_POLL_SECONDS)
                    continue
                self.alone = True
            except OSError:
                self.locks = False
        if not self.locks:
            self.warn(f"{self.output}: no locks on this file system; make sure that no other run writes there")

    def _try_lock(self, kind: int) -> bool:
        try:
            fcntl.flock(self._folder, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def set_up(self, text: str, overwrite: bool) -> None:
        """Set the folder up for the run with this text of ``run.yaml``, and admit other processes of the run.

        Raises
        ------
        ConfigError
            If it has results of another config and ``overwrite`` is not set, if files that no run wrote have the names
            of a run's files, or if other processes write a run of another config there.
        """
        output, known = self.output, read_text(self.output / RUN_FILE)
        if (self.alone or not self.locks) and known != text:
            check_folder(output, text, overwrite)
            for record in records_below(output, digest(known.encode())):  # of the replaced run
                remove_results(output / record.scene)
            write_text(output / RUN_FILE, text)
            flush(output / RUN_FILE)  # otherwise a power cut could leave records of an unknown run
        if read_text(output / RUN_FILE) != text:
            raise ConfigError(f"{output}: another depthcli writes a run of another config there now; choose another")
        self.share()

    def share(self) -> None:
        """Remove leftovers of killed processes, and admit other processes."""
        if self.alone:
            remove_leftovers(self.output)
        if self.locks:
            with contextlib.suppress(OSError):
                self._scenes = os.open(self.output / LOCKS_FILE, os.O_RDWR | os.O_CREAT, 0o666)
                if self.alone:
                    fcntl.flock(self._folder, fcntl.LOCK_SH)
        self.alone = False

    def claim(self, name: str, wait: bool = False) -> bool:
        """Claim a scene, or the report, which has no name; return False if another process has it."""
        if self._scenes < 0:
            return True
        try:
            fcntl.lockf(self._scenes, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB), 1, _byte(name))
        except (BlockingIOError, PermissionError):
            return False
        except OSError:
            pass  # the file system has no such locks
        return True

    def release(self, name: str) -> None:
        """Release a scene, or the report."""
        if self._scenes >= 0:
            with contextlib.suppress(OSError):
                fcntl.lockf(self._scenes, fcntl.LOCK_UN, 1, _byte(name))

    @contextlib.contextmanager
    def reporting(self) -> Iterator[None]:
        """Lock the report during the block."""
        self.claim(_REPORT, wait=True)
        try:
            yield
        finally:
            self.release(_REPORT)

    def last(self) -> bool:
        """Return whether all other processes have ended; then the folder is locked against new ones."""
        with contextlib.suppress(OSError):
            if self.locks and self._try_lock(fcntl.LOCK_EX):
                self.alone = True
                (self.output / LOCKS_FILE).unlink(missing_ok=True)
        return self.alone


def _byte(name: str) -> int:
    """Return the byte of the file of locks for a scene, or for the report."""
    if name == _REPORT:
        return 0
    return 1 + int.from_bytes(hashlib.sha256(name.encode("utf-8", "surrogateescape")).digest()[:7], "big")


@contextlib.contextmanager
def staging_folder(folder: Path, command: str, patterns: Sequence[str], warn: Callable[[str], None]) -> Iterator[Path]:
    """Yield a hidden folder to write into; at the end of the block, its files replace earlier results.

    This is for commands that write one set of files instead of scenes; ``patterns`` match the paths of their results.
    If the block raises, ``folder`` stays unchanged.

    Raises
    ------
    ConfigError
        Before the block, if the folder has results of another command, or files with the names of results that no
        record claims.
    OutputError
        If the folder cannot be written.
    """

    @contextlib.contextmanager
    def naming() -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from error

    made = hidden_folder(folder)
    with FolderLock(folder, warn) as lock:
        try:
            known = read_record(folder)
            if known is not None and known.run != command:
                raise ConfigError(f"{folder}: has results of another command; choose another --output")
            fresh = not any(os.path.lexists(folder / name) for name in (RECORD_FILE, CLAIM_FILE))
            there = {path for pattern in patterns for path in folder.glob(pattern) if not path.is_dir()}
            if fresh and there:
                foreign = sorted(path.relative_to(folder).as_posix() for path in there)
                raise ConfigError(f"{folder}: {not_ours(foreign)}")
            with naming():
                lock.share()
                made.mkdir()
            yield made
            with lock.reporting(), naming():
                install(made, folder, Record("", command, {}, digests_below(made), {}))
                flush(folder.parent)
        finally:
            discard(made)


def check_folder(output: Path, text: str, overwrite: bool) -> None:
    """Raise OutputError or ConfigError if a run with this text of ``run.yaml`` cannot use the folder."""
    if os.path.lexists(output) and not os.path.isdir(output):
        raise OutputError(f"{output}: cannot be used as a run folder (Not a directory)")
    if read_text(output / RUN_FILE) == text:
        return
    if (reason := refusal(output, text)) and not overwrite:
        raise ConfigError(f"{output}: {reason}; choose another --output, or --overwrite it")
    foreign = [name for name in (RUN_FILE, *REPORT_FILES, LEGEND_FILE) if os.path.lexists(output / name)]
    if foreign and not read_text(output / RUN_FILE).startswith(TITLE) and not holds_results(output):
        raise ConfigError(f"{output}: {not_ours(foreign)}")


def refusal(folder: Path, text: str) -> str:
    """Return a reason if a folder has another run than ``text`` that needs ``--overwrite``, or an empty text."""
    known = read_text(folder / RUN_FILE)
    if not os.path.lexists(folder / RUN_FILE) or known == text or not holds_results(folder):
        return ""
    if not known:
        return f"has a run of another config (its {RUN_FILE} cannot be read)"
    old, new = known.splitlines(), text.splitlines()
    removed = [line.strip() for line in old if line not in new and not line.startswith("#")]
    added = [line.strip() for line in new if line not in old and not line.startswith("#")]
    changes = f"it has {'; '.join(removed[:3])!r}, this run {'; '.join(added[:3])!r}"
    return f"has a run of another config ({changes})"


def holds_results(folder: Path) -> bool:
    """Return whether any scene is done or has a damaged record; evaluations and runs below are ignored."""
    deeper = (path for path in folder.glob(f"*/*/{RECORD_FILE}") if not (path.parents[1] / RUN_FILE).exists())
    records = (read_record(path.parent) for paths in (folder.glob(f"*/{RECORD_FILE}"), deeper) for path in paths)
    return any(record is None or (record.scene and record.row.get("status") == "done") for record in records)
