"""What the commands that match image pairs have in common."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar

from depthcli.batch.command import Outcome, Values
from depthcli.batch.console import SIZE, Column, Reporter, percent
from depthcli.batch.json_csv import Row
from depthcli.commands._batch import ConfigCommand
from depthcli.core.errors import InputError
from depthcli.data.scenes import Scene
from depthcli.data.scenes.stereo import StereoScene

if TYPE_CHECKING:
    from depthcli.core.frames import StereoPair
    from depthcli.data.formats.pictures import Palette
    from depthcli.device import Device
    from depthcli.methods.stereo.config import PairConfig
    from depthcli.methods.stereo.matching import Limits
    from depthcli.methods.stereo.search_range import SearchRange
    from depthcli.methods.stereo.stages import Matcher
    from depthcli.methods.stereo.volume import StereoResult

PairConfigT = TypeVar("PairConfigT", bound="PairConfig")

_MIN_MEASURED_SHARE = 0.5  # of the pixels; with fewer a scene has a warning
_MAX_SHARE_AT_END = 0.05  # of the measured pixels at an end of the search range; with more a scene has a warning


class PairCommand(ConfigCommand[PairConfigT, StereoScene]):
    """Reads a pair, matches it, writes the left view's map."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (StereoScene,)
    results: ClassVar[tuple[str, ...]] = ("disp_left.*", "status.png", "preview.png", "confidence_*")

    @abstractmethod
    def matcher(self, config: PairConfigT, scene: StereoScene) -> Matcher:
        """Return what matches the scene's pair."""

    def device(self, config: PairConfigT) -> Device | None:
        """Return the device to match on, None for the processor."""
        return None

    def device_columns(self, config: PairConfigT) -> dict[str, str]:
        """Return columns of the report that say where scenes were matched, if not on the processor."""
        return {}

    def limits(self, config: PairConfigT, memory: int) -> Limits:
        """Return where a pair may be matched, and in how much memory."""
        from depthcli.methods.stereo.matching import Limits

        return Limits(memory, config.tiles, config.tile_memory << 20, self.device(config))

    def memory_of(self, config: PairConfigT, scene: StereoScene) -> int | None:
        """Estimate by the left image's size; None where key points give the range, InputError where nothing does."""
        from depthcli.data.formats.headers import image_size
        from depthcli.methods.stereo.matching import host_bytes

        min_disparity, max_disparity = given_range(config, scene)
        _check_range(config, scene, max_disparity)
        if not (isinstance(min_disparity, int) and isinstance(max_disparity, int)):
            return None
        shape, limits = image_size(scene.left)[:2], self.limits(config, 0)
        return host_bytes(self.matcher(config, scene), shape, max_disparity - min_disparity, limits)

    def effort(self, config: PairConfigT, scene: StereoScene) -> int | None:
        """Return pixels times disparities, from the beginning of the left image's file."""
        from depthcli.data.formats.headers import peeked_size

        size = peeked_size(scene.left)
        if size is None:
            return None
        min_disparity, max_disparity = given_range(config, scene)
        n_disparities = size.width // 4 + 1  # ranges by key points are in proportion to the width
        if isinstance(min_disparity, int) and isinstance(max_disparity, int):
            n_disparities = max_disparity - min_disparity + 1
        return size.height * size.width * max(n_disparities, 1)

    def columns(self) -> tuple[Column, ...]:
        """Return size of the map, share of pixels with a value, share that was measured rather than filled."""

        return (SIZE, Column("density", percent("density")), Column("measured", percent("measured")))

    def palette(self) -> Palette:
        from depthcli.data.formats.pictures import STATUS_PALETTE

        return STATUS_PALETTE

    def legend_values(self) -> tuple[int, ...]:
        """Return each reason, alone and filled."""
        from depthcli.core.maps import Status

        reasons = [int(bit) for bit in (Status.OCCLUDED, Status.MISMATCH, Status.OUT_OF_RANGE, Status.NO_DATA)]
        return (0, int(Status.SMOOTHED), *reasons, *(bit | int(Status.FILLED) for bit in reasons))

    def run(self, values: Values, reporter: Reporter) -> int:
        """Run as every such command; a calibration that cannot be read is an error before any scene is opened."""
        from depthcli.commands._rectified import read_rig

        calibration = self.config(values).calibration
        if calibration is not None:
            read_rig(calibration)
        return super().run(values, reporter)

    def files(self, config: PairConfigT, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair, and the calibration that rectifies it."""
        names = () if config.calibration is None else config.calibration.files
        return scene.input_files | {f"calibration_{k}": Path(name) for k, name in enumerate(names)}

    def settings(self, config: PairConfigT, scene: StereoScene) -> dict[str, str]:
        """Return the search range, which may come from a file beside the images."""
        min_disparity, max_disparity = given_range(config, scene)
        lower = {} if min_disparity == 0 else {"min_disparity": str(min_disparity)}
        return {"max_disparity": str(max_disparity), **lower}

    def compute(self, config: PairConfigT, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Match one pair: load or rectify, search range, match, save.

        Raises
        ------
        InputError
            The images cannot be used, the search range is unknown, or ``memory`` bytes do not suffice.
        """
        import numpy as np

        from depthcli.commands._rectified import rectified_pair
        from depthcli.commands._save import save_stereo
        from depthcli.core.result import Clock
        from depthcli.core.text import show_bytes
        from depthcli.methods.stereo.matching import match
        from depthcli.methods.stereo.search_range import complete_range

        clock = Clock()
        min_disparity, max_disparity = given_range(config, scene)
        _check_range(config, scene, max_disparity)
        matcher, limits = self.matcher(config, scene), self.limits(config, memory)
        device_columns = self.device_columns(config)
        facts: Row = {}
        warnings: list[str] = []
        if config.calibration is None:
            clock.start("load")
            pair = scene.load()
        else:
            clock.start("rectify")
            pair, facts, warnings = rectified_pair(config.calibration, scene, folder)
        if max_disparity is None or "auto" in (min_disparity, max_disparity):
            clock.start("range")
        search, key_points = complete_range(min_disparity, max_disparity, pair)
        clock.start("other")
        shifted = search.shift(pair)
        matched = match(matcher, shifted, search.shifted_max_disparity, limits)
        result = search.restore(matched, pair.shape[1])
        del matched
        clock.include(result.seconds)
        clock.start("save")
        measured = float(np.mean(result.disparity.measured))
        warnings += _warnings(pair, result, measured, search, key_points)
        if result.figures.get("exact") == 0 and memory < limits.tile_memory:
            warnings.append(
                f"matched in {result.figures['tiles']:.0f} tiles at {result.figures['levels']:.0f} sizes, since only "
                f"{show_bytes(memory)} of memory may be used: with more the map is another one"
            )
        save_stereo(result, folder, search.min_disparity, search.max_disparity)
        columns = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": search.max_disparity,
            **({"min_disparity": search.min_disparity} if search.min_disparity or key_points else {}),
            **facts,
            **key_points,
            "density": round(result.disparity.density, 6),
            "measured": round(measured, 6),
            **({"bits": pair.bits} if _partly_used(pair) else {}),
            **{name: float(value) for name, value in result.figures.items()},
            **device_columns,
        }
        return Outcome(columns, clock.seconds, warnings)


def given_range(config: PairConfig, scene: StereoScene) -> tuple[int | str, int | str | None]:
    """Return the ends of the range that the config, or else the scene, gives; the upper one None where neither does."""
    min_disparity = scene.min_disparity if config.min_disparity is None else config.min_disparity
    return min_disparity, scene.max_disparity if config.max_disparity is None else config.max_disparity


def _check_range(config: PairConfig, scene: StereoScene, max_disparity: int | str | None) -> None:
    if max_disparity is None and config.calibration is None:  # rectified pairs have a range that key points suggest
        raise InputError(f"{scene.folder}: the search range is not known; say it with --max-disparity, or auto")


def _partly_used(pair: StereoPair) -> bool:
    return pair.bits is not None and pair.bits < 8 * pair.left.dtype.itemsize


def _warnings(
    pair: StereoPair, result: StereoResult, measured: float, search: SearchRange, key_points: dict[str, int]
) -> list[str]:
    warnings = []
    if _partly_used(pair):
        warnings.append(f"samples of {pair.bits} bits in {pair.left.dtype} files; scaled accordingly")
    if measured < _MIN_MEASURED_SHARE:
        warnings.append(
            f"only {100 * measured:.0f} % of the map was measured, the rest is filled in or empty: views swapped, "
            "not rectified, search range too small, or no texture?"
        )
    ends = ((search.min_disparity, "--min-disparity"), (search.max_disparity, "--max-disparity"))
    for share, (end, option) in zip(search.share_at_ends(result.disparity), ends, strict=True):
        if share > _MAX_SHARE_AT_END:
            warnings.append(
                f"{100 * share:.0f} % of the measured pixels lie at the end of the search range, {end}; see {option}"
            )
    if key_points and search.min_disparity > key_points["range_low"] and key_points["range_low"] < 0:
        warnings.append(f"key points have disparities down to {key_points['range_low']}; see --min-disparity")
    if search.min_disparity < 0:
        warnings.append("disp_left.png cannot hold negative disparities: no value there; disp_left.pfm has them")
    return warnings
