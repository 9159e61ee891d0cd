"""What the commands that match image pairs have in common."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar

from depthcli.commands._old_batch import ConfigCommand
from depthcli.commands._old_options import UNIT
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene
from depthcli.run.batch import Outcome
from depthcli.run.command import Values
from depthcli.run.console import SIZE, Column, Reporter, percent
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    from depthcli.device import Device
    from depthcli.io.formats.pictures import Palette
    from depthcli.methods.stereo.config import PairConfig
    from depthcli.methods.stereo.matching import Limits
    from depthcli.methods.stereo.stages import PairMatcher

PairConfigT = TypeVar("PairConfigT", bound="PairConfig")


class PairCommand(ConfigCommand[PairConfigT, StereoScene]):
    """Reads a pair, matches it, writes the left view's map."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (StereoScene,)
    results: ClassVar[tuple[str, ...]] = ("disp_left.*", "status.png", "preview.png", "confidence_*")
    shown_as: ClassVar[str] = "middlebury-v2"

    @property
    def options(self) -> tuple[Option, ...]:
        return (*super().options, UNIT)

    def config(self, values: Values) -> PairConfigT:
        """Return the config, with the unit of its calibration where that is given."""
        config, unit = super().config(values), values.get("unit")
        if unit is None:
            return config
        from depthcli.commands._rectified import check_unit

        check_unit(unit)
        if config.calibration is None:
            raise ConfigError("--unit: there is no calibration; give --calibration FILE, too")
        return config.model_copy(update={"calibration": config.calibration.model_copy(update={"unit": unit})})

    @abstractmethod
    def matcher(self, config: PairConfigT, scene: StereoScene) -> PairMatcher:
        """Return what matches the scene's pair."""

    def device(self, config: PairConfigT) -> Device | None:
        """Return the device to match on, None for the processor."""
        return None

    def device_columns(self, config: PairConfigT) -> dict[str, str]:
        """Return columns of the report that say where scenes were matched, if not on the processor."""
        return {}

    def limits(self, config: PairConfigT, memory: int) -> Limits:
        """Return where a pair may be matched, and in how much memory."""
        from depthcli.api.matching import limits_of

        return limits_of(config, memory, self.device(config))

    def memory_of(self, config: PairConfigT, scene: StereoScene) -> int | None:
        """Estimate by the left image's size; None where key points give the range."""
        from depthcli.io.formats.images import image_size
        from depthcli.methods.stereo.matching import host_bytes

        min_disparity, max_disparity = given_range(config, scene)
        if not (isinstance(min_disparity, int) and isinstance(max_disparity, int)):
            return None
        shape, limits = image_size(scene.left), self.limits(config, 0)
        return host_bytes(self.matcher(config, scene), shape, max_disparity - min_disparity, limits)

    def effort(self, config: PairConfigT, scene: StereoScene) -> int | None:
        """Return pixels times disparities, from the beginning of the left image's file."""
        from depthcli.io.formats.images import image_size

        try:
            height, width = image_size(scene.left)
        except InputError:
            return None
        min_disparity, max_disparity = given_range(config, scene)
        n_disparities = width // 4 + 1  # ranges by key points are in proportion to the width
        if isinstance(min_disparity, int) and isinstance(max_disparity, int):
            n_disparities = max_disparity - min_disparity + 1
        return height * width * max(n_disparities, 1)

    def columns(self) -> tuple[Column, ...]:
        """Return size of the map, share of pixels with a value, share that was measured rather than filled."""

        return (SIZE, Column("density", percent("density")), Column("measured", percent("measured")))

    def palette(self) -> Palette:
        from depthcli.io.formats.pictures import STATUS_PALETTE

        return STATUS_PALETTE

    def legend_values(self) -> tuple[int, ...]:
        """Return each reason, alone and filled."""
        from depthcli.core.maps import Status

        reasons = [int(bit) for bit in (Status.OCCLUDED, Status.MISMATCH, Status.OUT_OF_RANGE, Status.NO_DATA)]
        return (0, int(Status.SMOOTHED), *reasons, *(bit | int(Status.FILLED) for bit in reasons))

    def run(self, values: Values, reporter: Reporter) -> int:
        """Run as every such command; a calibration that cannot be read is an error before any scene is opened."""
        config = self.config(values)
        if config.calibration is not None:
            from depthcli.api.matching import read_rig

            read_rig(config.calibration)
        return super().run(values, reporter)

    def files(self, config: PairConfigT, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair, the calibration that rectifies it, and the frames that give its range."""
        names = () if config.calibration is None else config.calibration.files
        frames = {
            f"range_{k}_{role}": file
            for k, frame in enumerate(_range_frames(config, scene))
            for role, file in frame.input_files.items()
        }
        return super().files(config, scene) | {f"calibration_{k}": Path(name) for k, name in enumerate(names)} | frames

    def settings(self, config: PairConfigT, scene: StereoScene) -> dict[str, str]:
        """Return the search range, which may come from a file beside the images."""
        min_disparity, max_disparity = given_range(config, scene)
        lower = {} if min_disparity == 0 else {"min_disparity": str(min_disparity)}
        return {"max_disparity": str(max_disparity), **lower}

    def notes(self, config: PairConfigT, scenes: Sequence[StereoScene], rows: Sequence[Row]) -> list[str]:
        """Return a line with the search range of scenes for which neither the config nor their files give one."""
        if config.max_disparity is not None or config.calibration is not None:
            return []
        unknown = {scene.name for scene in scenes if not scene.problem and scene.max_disparity is None}
        ends = [row["max_disparity"] for row in rows if row["scene"] in unknown and "max_disparity" in row]
        if not ends:
            return []
        which = "the search range is" if len(ends) == 1 else f"the search ranges of {len(ends)} scenes are"
        span = f"{ends[0]}" if len(set(ends)) == 1 else f"{min(ends)} to {max(ends)}"
        return [
            f"{which} not known: --max-disparity auto was taken, which gives {span} px (max_disparity in report.csv)"
        ]

    def compute(self, config: PairConfigT, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Match one pair: load or rectify, search range, match, save.

        Raises
        ------
        InputError
            The images cannot be used, too few key points match where they give the range, or ``memory`` is too little.
        """
        import numpy as np

        from depthcli.api.matching import match_pair, partly_used
        from depthcli.commands._rectified import rectified_pair, sequence_range
        from depthcli.core.result import Clock
        from depthcli.core.scene import current_scene

        clock = Clock()
        min_disparity, max_disparity = given_range(config, scene)
        matcher, limits = self.matcher(config, scene), self.limits(config, memory)
        device_columns = self.device_columns(config)
        facts: Row = {}
        warnings: list[str] = []
        known = save = None
        if frames := _range_frames(config, scene):
            clock.start("range")
            known = sequence_range(config.calibration, frames)
        if config.calibration is None:
            clock.start("load")
            pair = scene.load()
            if scene.right is not None and scene.frame_number is None:
                current_scene().originals = pair, (scene.left, scene.right)
        else:
            clock.start("rectify")
            pair, save, facts, warnings = rectified_pair(config.calibration, scene, folder)
        with _meanwhile(save):
            found = match_pair(matcher, pair, (min_disparity, max_disparity), limits, clock, known)
        clock.start("save")
        found.save(folder)
        search, key_points = found.search, found.key_points
        columns = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": search.max_disparity,
            **({"min_disparity": search.min_disparity} if search.min_disparity or key_points else {}),
            **facts,
            **key_points,
            "density": round(found.density, 6),
            "measured": round(float(np.mean(found.measured)), 6),
            **({"bits": pair.bits} if partly_used(pair) else {}),
            **{name: float(value) for name, value in found.details.figures.items()},
            **device_columns,
        }
        return Outcome(columns, clock.seconds, [*warnings, *found.warnings])


@contextlib.contextmanager
def _meanwhile(task: Callable[[], None] | None) -> Iterator[None]:
    """Do ``task`` in another thread while the block runs; raise its exception at the end of the block."""
    if task is None:
        yield
        return
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(task)
        yield
        done.result()


def _range_frames(config: PairConfig, scene: StereoScene) -> tuple[StereoScene, ...]:
    """Return the frames of the scene's sequence whose key points give its search range; none where they do not.

    They give that of pairs that a calibration rectifies, and of videos, but an end that the user calls "auto" is that
    of each pair by itself.
    """
    ends = config.min_disparity, config.max_disparity
    if "auto" in ends or config.max_disparity is not None or scene.max_disparity is not None:
        return ()
    return scene.sequence if config.calibration is not None or scene.frame_number is not None else ()


def given_range(config: PairConfig, scene: StereoScene) -> tuple[int | str, int | str | None]:
    """Return the ends of the range that the config, or else the scene, gives.

    Where neither gives the upper one it is "auto", and None for a pair that a calibration rectifies: then both ends
    are as key points suggest.
    """
    min_disparity = scene.min_disparity if config.min_disparity is None else config.min_disparity
    max_disparity = scene.max_disparity if config.max_disparity is None else config.max_disparity
    if max_disparity is None and config.calibration is None:
        max_disparity = "auto"
    return min_disparity, max_disparity
