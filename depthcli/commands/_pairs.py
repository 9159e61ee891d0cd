"""What the commands that match image pairs have in common."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from depthcli.batch.command import Values
from depthcli.commands._batch import ConfigCommand
from depthcli.core.errors import InputError
from depthcli.data.scenes import Scene
from depthcli.data.scenes.stereo import StereoScene

if TYPE_CHECKING:
    from depthcli.batch.making import Outcome
    from depthcli.batch.reporter import Reporter
    from depthcli.batch.tables import Column
    from depthcli.core.frames import StereoPair
    from depthcli.core.maps import DisparityMap
    from depthcli.data.formats.pictures import Palette
    from depthcli.methods.stereo.large import Matcher
    from depthcli.methods.stereo.search_range import SearchRange
    from depthcli.methods.stereo.volume import StereoResult

_FEW = 0.5  # share of measured pixels below which a map says so
_AT_END = 0.05  # share of measured pixels at an end of the search range above which it does


class PairCommand(ConfigCommand[Any, StereoScene]):
    """Reads a pair, matches it, writes the left view's map."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (StereoScene,)

    @abstractmethod
    def match(self, config: Any, scene: StereoScene, pair: StereoPair, top: int) -> StereoResult:
        """Match over disparities 0 .. ``top`` inclusive."""

    @abstractmethod
    def peak_bytes(self, config: Any, shape: tuple[int, int], top: int) -> int:
        """Estimate of the peak working memory."""

    def facts(self, config: Any) -> dict[str, Any]:
        """What else the report says of every scene."""
        return {}

    def in_tiles(self, config: Any) -> Matcher | None:
        """What can match a pair in tiles; None where nothing can."""
        return None

    def memory_of(self, config: Any, scene: StereoScene) -> int | None:
        """By the size of the left image; None where key points tell the range; InputError where nothing does."""
        from depthcli.batch.plan import shape_of

        low, top = asked_range(config, scene)
        if top is None and config.calibration is None:
            raise _no_range(scene)
        if top is None or isinstance(low, str) or isinstance(top, str):
            return None
        need: int = self.peak_bytes(config, shape_of(scene.left), top - low)
        if config.tiles == "never" or self.in_tiles(config) is None:
            return need
        most: int = config.tile_memory << 20
        return min(need, most)

    def effort(self, config: Any, scene: StereoScene) -> int | None:
        """Pixels times disparities, from the beginning of the left image's file."""
        from depthcli.data.formats.headers import peeked_size

        size = peeked_size(scene.left)
        if size is None:
            return None
        low, top = asked_range(config, scene)
        # Ranges by key points are in proportion to the width.
        span = top - low if isinstance(low, int) and isinstance(top, int) else size.width // 4
        return size.height * size.width * max(span + 1, 1)

    def columns(self) -> tuple[Column, ...]:
        """Size of the map, share of pixels with a value, share that was measured rather than filled."""
        from depthcli.batch.tables import SIZE, Column, percent

        return (SIZE, Column("density", percent("density")), Column("measured", percent("measured")))

    def palette(self) -> Palette:
        """Of a disparity map's status."""
        from depthcli.data.formats.pictures import STATUS_PALETTE

        return STATUS_PALETTE

    def legend_values(self) -> tuple[int, ...]:
        """Each reason, alone and filled."""
        from depthcli.core.maps import Status

        reasons = [int(bit) for bit in (Status.OCCLUDED, Status.MISMATCH, Status.OUT_OF_RANGE, Status.NO_DATA)]
        return (0, int(Status.SMOOTHED), *reasons, *(bit | int(Status.FILLED) for bit in reasons))

    def run(self, values: Values, reporter: Reporter) -> int:
        """As every such command; a calibration that cannot be read is told before any scene is looked at."""
        self._check_calibration(self.config(values))
        return super().run(values, reporter)

    def _check_calibration(self, config: Any) -> None:
        if config.calibration is not None:
            from depthcli.data.formats.stereo_rig import read_stereo_rig

            how = config.calibration
            read_stereo_rig([Path(file) for file in how.files], how.unit, how.fisheye, how.cameras)

    def files(self, config: Any, scene: StereoScene) -> dict[str, Path]:
        """The pair, and the calibration that rectifies it."""
        from depthcli.commands._rectified import calibration_files

        return scene.input_files | calibration_files(config.calibration)

    def settings(self, config: Any, scene: StereoScene) -> dict[str, str]:
        """The search range, which may come from a file beside the images."""
        low, top = asked_range(config, scene)
        return {"max_disparity": str(top), **({} if low == 0 else {"min_disparity": str(low)})}

    def compute(self, config: Any, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Match one pair.

        Raises
        ------
        InputError
            The images cannot be used, the search range is unknown, or ``memory`` bytes do not suffice.
        """
        import numpy as np

        from depthcli.batch.making import Outcome
        from depthcli.batch.resources import show_bytes
        from depthcli.commands._rectified import rectified_pair
        from depthcli.commands._save import save_stereo
        from depthcli.core.maps import Status
        from depthcli.core.result import Clock

        clock = Clock()
        rows: dict[str, Any] = {}
        warnings: list[str] = []
        if config.calibration is None:
            pair = scene.load()
            clock.stop("load")
        else:
            pair, rows, warnings = rectified_pair(config.calibration, scene, folder)
            clock.stop("rectify")
        search, said = _search_range(config, scene, pair)
        clock.stop("range")
        shifted = search.shift(pair)
        matched = self._within(config, scene, shifted, search.last, memory)
        tiles = matched.figures.get("tiles", 0)
        result = search.restore(matched, pair.shape[1])
        del matched
        clock.stop("other")
        clock.seconds["other"] = max(clock.seconds["other"] - sum(result.seconds.values()), 0.0)
        status = result.disparity.status
        measured = float(np.mean(((status & Status.FILLED) == 0) & result.disparity.valid))
        facts = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": search.top,
            **({"min_disparity": search.low} if search.low or said else {}),
            **rows,
            **said,
            "density": round(result.disparity.density, 6),
            "measured": round(measured, 6),
            **({"bits": pair.bits} if _partly_used(pair) else {}),
            **{name: float(value) for name, value in result.figures.items()},
            **self.facts(config),
        }
        save_stereo(result, folder, search.low, search.top)
        clock.stop("save")
        if "range_matches" not in said:
            del clock.seconds["range"]
        first = "load" if config.calibration is None else "rectify"
        seconds = {first: clock.seconds[first], **result.seconds} | clock.seconds
        warnings += [*_warnings(pair, measured), *_range_warnings(result.disparity, search, said)]
        if tiles and not result.figures["exact"] and memory < config.tile_memory << 20:
            warnings.append(
                f"matched in {tiles:.0f} tiles at {result.figures['levels']:.0f} sizes, since only "
                f"{show_bytes(memory)} of memory may be used: with more the map is another one"
            )
        return Outcome(facts, seconds, warnings)

    def _within(self, config: Any, scene: StereoScene, pair: StereoPair, top: int, memory: int) -> StereoResult:
        """Match the pair whole or, where that needs too much memory or the config says so, in tiles."""
        from depthcli.batch.resources import show_bytes
        from depthcli.methods.stereo.large import match_in_tiles

        need = self.peak_bytes(config, pair.shape, top)
        matcher = None if config.tiles == "never" else self.in_tiles(config)
        # By the config rather than by what is free: the map must not depend on the number of workers.
        tiled = min(memory, config.tile_memory << 20)
        if matcher is not None and (need > tiled or config.tiles == "always"):
            return match_in_tiles(matcher, pair, top, tiled)
        if need > memory:
            raise InputError(
                f"needs about {show_bytes(need)} of memory ({pair.shape[1]} x {pair.shape[0]} pixels, "
                f"{top + 1} disparities), {show_bytes(memory)} may be used; see --max-memory, --jobs, --max-disparity"
            )
        return self.match(config, scene, pair, top)


def asked_range(config: Any, scene: StereoScene) -> tuple[int | str, int | str | None]:
    """Ends of the range as they were said, the upper one None where it was not."""
    low = scene.min_disparity if config.min_disparity is None else config.min_disparity
    return low, scene.max_disparity if config.max_disparity is None else config.max_disparity


def _no_range(scene: StereoScene) -> InputError:
    return InputError(f"{scene.folder}: the search range is not known; say it with --max-disparity, or auto")


def _search_range(config: Any, scene: StereoScene, pair: StereoPair) -> tuple[SearchRange, dict[str, int]]:
    """The range, and where key points were asked for it what they said.

    A pair that was rectified just now has the one that ``rectify`` would have suggested.
    """
    from depthcli.commands._rectified import suggested_range
    from depthcli.methods.stereo.search_range import SearchRange, range_of_key_points

    low, top = asked_range(config, scene)
    if top is None and config.calibration is not None:
        ends = suggested_range(pair)
        low, top = (low if low not in (0, "auto") else ends["min_disparity"]), ends["max_disparity"]
    if top is None:
        raise _no_range(scene)
    said = {}
    if "auto" in (low, top):
        found, matches = range_of_key_points(pair)
        said = {"range_matches": matches, "range_low": found.low, "range_top": found.top}
        low, top = (found.low if low == "auto" else low), (found.top if top == "auto" else top)
    assert isinstance(low, int) and isinstance(top, int)
    if top <= low:
        raise InputError(f"{scene.folder}: disparities from {low} to {top} are to be searched, which are none")
    return SearchRange(low, top), said


def _range_warnings(disparity: DisparityMap, search: SearchRange, said: dict[str, int]) -> list[str]:
    """Of pixels at the range's ends, and of files that cannot hold it."""
    found = []
    for share, end, option in zip(
        search.share_at_ends(disparity), (search.low, search.top), ("--min-disparity", "--max-disparity"), strict=True
    ):
        if share > _AT_END:
            found.append(
                f"{100 * share:.0f} % of the measured pixels lie at the end of the search range, {end}; see {option}"
            )
    if said and search.low > said["range_low"] and said["range_low"] < 0:
        found.append(f"key points have disparities down to {said['range_low']}; see --min-disparity")
    if search.low < 0:
        found.append("disp_left.png cannot hold negative disparities: no value there; disp_left.pfm has them")
    return found


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
