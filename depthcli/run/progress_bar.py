"""The progress of a run: a bar on a terminal, else a line every 30 seconds."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from depthcli.core.text import one_line

if TYPE_CHECKING:
    from tqdm import tqdm

    from depthcli.run.activities import Running

_TICK = 0.2  # seconds between two looks at what is being done
_REDRAW = 1.0  # seconds after which the bar is drawn again although only its time has changed
_HEARTBEAT = 30.0  # seconds between lines where there is no terminal
_MAX_SHOWN = 3  # scenes at a time whose stages are shown


class Progress:
    """Counts what is done, looks at what is being done, and shows both from a thread of its own.

    Times of scenes, from which that of the end is estimated, leave out what comes before the first one, and the time in
    which kernels are compiled.

    Parameters
    ----------
    what : name of the command
    total, done : number of scenes, and how many of them were done before
    unit : what is counted
    running : returns what is being done at the moment; None where that is not known
    say : prints a line
    bar : draw a bar on stderr; else say lines
    """

    def __init__(
        self, what: str, total: int, done: int, unit: str, running: Callable[[], Sequence[Running]] | None,
        say: Callable[[str], None], bar: bool,
    ) -> None:  # fmt: skip
        self._what, self._total, self._unit = what, total, unit
        self._done, self._computed, self._failed = done, 0, 0
        self._running: Callable[[], Sequence[Running]] = running or list
        self._begun, self._say = running is None, say
        self._seen = self._said = time.monotonic()
        self._spent = self._spent_on_computed = 0.0  # seconds without compilation; those at the last scene's end
        self._shown, self._drawn = "", self._seen
        self._bar = self._new_bar() if bar else None
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def step(self, failed: bool, computed: bool) -> None:
        """Count one more scene; one that was not ``computed`` by this run says nothing about the time of others."""
        with self._lock:
            self._look()
            self._done += 1
            self._failed += failed
            if computed:
                self._computed += 1
                self._spent_on_computed = self._spent

    def write(self, text: str) -> None:
        """Print a line on stderr, above the bar."""
        if self._bar is None:
            print(text, file=sys.stderr, flush=True)
        else:
            self._bar.write(text, file=sys.stderr)

    def close(self) -> None:
        """Take the bar away."""
        self._over.set()
        self._thread.join()
        if self._bar is not None:
            with contextlib.suppress(OSError, ValueError):
                self._bar.close()

    def show(self) -> None:
        """Draw the bar again where something has changed, or say a line where it is time to."""
        with self._lock:
            now, running = self._look()
            left = self._left()
            if self._bar is not None:
                text = self._bar_text(running, left)
                if text != self._shown or now - self._drawn >= _REDRAW:
                    self._shown, self._drawn = text, now
                    self._bar.n = self._done
                    self._bar.set_description_str(text)
                return
            if now - self._said < _HEARTBEAT:
                return
            self._said = now
        self._say(self._line(running, left))

    def _watch(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # stderr was closed
            while not self._over.wait(_TICK):
                self.show()

    def _look(self) -> tuple[float, Sequence[Running]]:
        """Return time and running scenes, and count the seconds since the last look where they are computing time."""
        now, running = time.monotonic(), self._running()
        if self._begun and not any(scene.compiling for scene in running):
            self._spent += now - self._seen
        self._seen, self._begun = now, self._begun or bool(running)
        return now, running

    def _left(self) -> str:
        """Return the time that is left as text, "" where no scene says how long one takes."""
        if not self._computed or self._done >= self._total:
            return ""
        each = self._spent_on_computed / self._computed
        seconds = max(each * (self._total - self._done) - (self._spent - self._spent_on_computed), 0.0)
        if seconds >= 5400:
            return f"about {seconds / 3600:.1f} h left"
        return f"about {seconds / 60:.0f} min left" if seconds >= 90 else f"about {seconds:.0f} s left"

    def _line(self, running: Sequence[Running], left: str) -> str:
        failures = f", {self._failed} failed" if self._failed else ""
        parts = [f"{self._what}: {self._done} of {self._total} {self._unit}s{failures}"]
        parts += [f"{scene.scene}: {', '.join(_stages(scene, ' of '))}" for scene in running[:_MAX_SHOWN]]
        parts += [f"{len(running) - _MAX_SHOWN} more"] * (len(running) > _MAX_SHOWN)
        return "; ".join([*parts, left] if left else parts)

    def _bar_text(self, running: Sequence[Running], left: str) -> str:
        if len(running) == 1:
            number = min(self._done + 1, self._total)
            parts = [f"{self._unit} {number}/{self._total} {running[0].scene}", *_stages(running[0], "/")]
        else:
            parts = [f"{self._done}/{self._total} {self._unit}s"]
            parts += [f"{scene.scene}: {', '.join(_stages(scene, '/'))}" for scene in running]
        failures = [f"{self._failed} failed"] * bool(self._failed)
        return one_line(" · ".join([*([left] if left else []), *failures, *parts]))

    def _new_bar(self) -> tqdm[Any] | None:
        from tqdm import tqdm

        form = f"{self._what.replace('{', '').replace('}', '')} {{bar:10}} {{elapsed}} {{desc}}"
        with contextlib.suppress(OSError, ValueError):
            return tqdm(total=self._total, initial=self._done, bar_format=form, file=sys.stderr, leave=False,
                        dynamic_ncols=True)  # fmt: skip
        return None


def _stages(scene: Running, of: str) -> list[str]:
    """Return what is being done for a scene; of a line that is too long, the end is not seen."""
    stage, unit, number, total = scene.activity
    texts = [stage.replace("_", " ") or "begins"]
    if total:
        texts.append(f"{unit} {number}{of}{total}")
    if scene.compiling:
        about = f" of about {scene.expected}" if scene.expected else ""
        texts.insert(0, f"compiling kernel {scene.kernels}{about}")
    return texts
