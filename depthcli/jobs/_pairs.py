"""What the commands that match image pairs have in common."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from depthcli.core.errors import InputError
from depthcli.io.items import Item
from depthcli.io.items.stereo import StereoItem
from depthcli.jobs._batch import ConfigCommand

if TYPE_CHECKING:
    from depthcli.batch.runner import Outcome
    from depthcli.batch.tables import Column
    from depthcli.core.frames import StereoPair
    from depthcli.io.pictures import Palette
    from depthcli.stereo.volume import StereoResult

_FEW = 0.5  # share of measured pixels below which a map says so


class PairCommand(ConfigCommand):
    """Reads a pair, matches it, writes the left view's map."""

    kinds: ClassVar[tuple[type[Item], ...]] = (StereoItem,)

    @abstractmethod
    def match(self, config: Any, item: StereoItem, pair: StereoPair, top: int) -> StereoResult:
        """Match over disparities 0 .. ``top`` inclusive."""

    @abstractmethod
    def peak_bytes(self, config: Any, shape: tuple[int, int], top: int) -> int:
        """Estimate of the peak working memory."""

    def memory_of(self, config: Any, item: StereoItem) -> int:
        """By the size of the left image; InputError where the search range is unknown."""
        from depthcli.batch.plan import shape_of

        return self.peak_bytes(config, shape_of(item.left), _top(config, item))

    def columns(self) -> tuple[Column, ...]:
        """Size of the map, share of pixels with a value, share that was measured rather than filled."""
        from depthcli.batch.tables import SIZE, Column, percent

        return (SIZE, Column("density", percent("density")), Column("measured", percent("measured")))

    def palette(self) -> Palette:
        """Of a disparity map's status."""
        from depthcli.io.pictures import STATUS_PALETTE

        return STATUS_PALETTE

    def legend_values(self) -> tuple[int, ...]:
        """Each reason, alone and filled."""
        from depthcli.core.maps import Status

        reasons = [int(bit) for bit in (Status.OCCLUDED, Status.MISMATCH, Status.OUT_OF_RANGE, Status.NO_DATA)]
        return (0, int(Status.SMOOTHED), *reasons, *(bit | int(Status.FILLED) for bit in reasons))

    def settings(self, config: Any, item: StereoItem) -> dict[str, str]:
        """The search range, which may come from a file beside the images."""
        return {"max_disparity": str(config.max_disparity or item.max_disparity)}

    def compute(self, config: Any, item: StereoItem, folder: Path, memory: int) -> Outcome:
        """Match one pair.

        Raises
        ------
        InputError
            The images cannot be used, the search range is unknown, or ``memory`` bytes do not suffice.
        """
        import numpy as np

        from depthcli.batch.runner import Outcome
        from depthcli.core.maps import Status
        from depthcli.core.result import Clock
        from depthcli.jobs._save import save_stereo

        clock = Clock()
        pair = item.load()
        top = _top(config, item)
        self._check_memory(config, pair, top, memory)
        clock.stop("load")
        result = self.match(config, item, pair, top)
        clock.stop("other")
        clock.seconds["other"] = max(clock.seconds["other"] - sum(result.seconds.values()), 0.0)
        status = result.disparity.status
        measured = float(np.mean(((status & Status.FILLED) == 0) & result.disparity.valid))
        facts = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": top,
            "density": round(result.disparity.density, 6),
            "measured": round(measured, 6),
            **({"bits": pair.bits} if _partly_used(pair) else {}),
            **{name: float(value) for name, value in result.figures.items()},
        }
        save_stereo(result, folder, top)
        clock.stop("save")
        seconds = {"load": clock.seconds["load"], **result.seconds} | clock.seconds
        return Outcome(facts, seconds, _warnings(pair, measured))

    def _check_memory(self, config: Any, pair: StereoPair, top: int, memory: int) -> None:
        from depthcli.batch.resources import show_bytes

        need = self.peak_bytes(config, pair.shape, top)
        if need > memory:
            raise InputError(
                f"needs about {show_bytes(need)} of memory ({pair.shape[1]} x {pair.shape[0]} pixels, "
                f"{top + 1} disparities), {show_bytes(memory)} may be used; see --max-memory, --jobs, --max-disparity"
            )


def _top(config: Any, item: StereoItem) -> int:
    top: int | None = config.max_disparity or item.max_disparity
    if top is None:
        raise InputError(f"{item.folder}: the search range is not known; say it with --max-disparity")
    return top


def _partly_used(pair: StereoPair) -> bool:
    return pair.bits is not None and pair.bits < 8 * pair.left.dtype.itemsize


def _warnings(pair: StereoPair, measured: float) -> list[str]:
    found = []
    if _partly_used(pair):
        found.append(f"samples of {pair.bits} bits in {pair.left.dtype} files; scaled accordingly")
    if measured < _FEW:
        found.append(
            f"only {100 * measured:.0f} % of the map was measured, the rest is filled in or empty: views swapped, "
            "not rectified, search range too small, or no texture?"
        )
    return found
