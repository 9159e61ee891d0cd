"""What ``stereo`` computes of a pair: load or rectify it, find its search range, match it, write map and status."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from depthcli.api.matching import device_of, limits_of, match_pair, partly_used, read_rig, with_address
from depthcli.commands._batch import config_of, run_batch
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.commands._rectified import check_unit, rectified_pair, sequence_range
from depthcli.commands._scenes import find_scenes
from depthcli.core.errors import ConfigError
from depthcli.core.maps import Status
from depthcli.core.method import device_implementation_of, used_files
from depthcli.core.result import Clock
from depthcli.core.scene import current_scene
from depthcli.device import Device
from depthcli.io.formats.images import image_size
from depthcli.io.formats.pictures import STATUS_PALETTE
from depthcli.io.scenes.stereo import StereoScene
from depthcli.methods.stereo.config import PairConfig, StereoConfig
from depthcli.methods.stereo.matching import Limits, host_bytes
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.run.batch import Batch, Outcome
from depthcli.run.console import SIZE, Column, percent
from depthcli.run.json_csv import Row

__all__ = ["MatchPairs", "batch_of", "config_with_calibration", "prepare", "run_batch"]

PairConfigT = TypeVar("PairConfigT", bound=PairConfig)

_REASONS = [int(bit) for bit in (Status.OCCLUDED, Status.MISMATCH, Status.OUT_OF_RANGE, Status.NO_DATA)]
# Each reason, alone and filled.
_LEGEND = (0, int(Status.SMOOTHED), *_REASONS, *(bit | int(Status.FILLED) for bit in _REASONS))


def prepare(
    config: str, pairs: SceneOptions, run: RunOptions, settings: Sequence[str | tuple[str, str]] | None, **options: Any
) -> tuple[Batch[StereoScene], list[StereoScene]]:
    """Return the batch of ``stereo`` with this config, and the pairs that the command line names."""
    found = with_address(config_with_calibration("stereo", StereoConfig, config, pairs, settings, **options))
    scenes = find_scenes((StereoScene,), pairs, run)
    return batch_of("stereo", MatchPairs(found), scenes), scenes


def config_with_calibration(
    command: str,
    model: type[PairConfigT],
    config: str,
    pairs: SceneOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    **options: object,
) -> PairConfigT:
    """Return the config with all overrides; ConfigError where it is wrong, or its calibration cannot be read."""
    for key in ("calibration", "max_disparity", "min_disparity"):
        options[key] = getattr(pairs, key, None)
    found, unit = config_of(command, model, config, settings, **options), getattr(pairs, "unit", None)
    if unit is not None:
        check_unit(unit)
        if found.calibration is None:
            raise ConfigError("--unit: there is no calibration; give --calibration FILE, too")
        found = found.model_copy(update={"calibration": found.calibration.model_copy(update={"unit": unit})})
    if found.calibration is not None:
        read_rig(found.calibration)  # one that cannot be read is an error before any scene is opened
    return found


def batch_of(command: str, match: MatchPairs, scenes: Sequence[StereoScene]) -> Batch[StereoScene]:
    """Return the batch of a command that matches pairs."""
    return Batch(
        command=command,
        config=match.config,
        compute=match,
        columns=(SIZE, Column("density", percent("density")), Column("measured", percent("measured"))),
        files=match.files,
        settings=match.settings,
        memory=match.memory,
        notes=lambda rows: _unknown_ranges(match.config, scenes, rows),
        palette=STATUS_PALETTE,
        legend=_LEGEND,
        shown_as="middlebury-v2",
    )


@dataclass(frozen=True)
class MatchPairs:
    """Matches one pair and writes the left view's map."""

    config: PairConfig

    def matcher(self, scene: StereoScene) -> PairMatcher:
        """Return what matches the scene's pair."""
        assert isinstance(self.config, StereoConfig)
        return self.config.pipeline

    def device(self) -> Device | None:
        """Return the device to match on, None for the processor."""
        return device_of(self.config) if isinstance(self.config, StereoConfig) else None

    def limits(self, memory: int) -> Limits:
        """Return where a pair may be matched, and in how much memory."""
        return limits_of(self.config, memory, self.device())

    def memory(self, scene: StereoScene) -> int | None:
        """Estimate by the left image's size; None where key points give the range."""
        low, top = self.given_range(scene)
        if not (isinstance(low, int) and isinstance(top, int)):
            return None
        return host_bytes(self.matcher(scene), image_size(scene.left), top - low, self.limits(0))

    def files(self, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair, the calibration that rectifies it, and the frames that give its range."""
        names = () if self.config.calibration is None else self.config.calibration.files
        frames = {
            f"range_{k}_{role}": file
            for k, frame in enumerate(self.range_frames(scene))
            for role, file in frame.input_files.items()
        }
        calibrations = {f"calibration_{k}": Path(name) for k, name in enumerate(names)}
        return scene.input_files | used_files(self.config) | calibrations | frames

    def settings(self, scene: StereoScene) -> dict[str, str]:
        """Return the search range, which may come from a file beside the images."""
        low, top = self.given_range(scene)
        return {"max_disparity": str(top), **({} if low == 0 else {"min_disparity": str(low)})}

    def given_range(self, scene: StereoScene) -> tuple[int | str, int | str | None]:
        """Return the ends of the range that the config, or else the scene, gives.

        Where neither gives the upper one it is "auto", and None for a pair that a calibration rectifies: then both ends
        are as key points suggest.
        """
        low, top = self.config.min_disparity, self.config.max_disparity
        low = scene.min_disparity if low is None else low
        top = scene.max_disparity if top is None else top
        return low, "auto" if top is None and self.config.calibration is None else top

    def range_frames(self, scene: StereoScene) -> tuple[StereoScene, ...]:
        """Return the frames of the scene's sequence whose key points give its range; none where they do not.

        They give that of pairs that a calibration rectifies, and of videos, but an end that the user calls "auto" is
        that of each pair by itself.
        """
        config = self.config
        if "auto" in (config.min_disparity, config.max_disparity):
            return ()
        if config.max_disparity is not None or scene.max_disparity is not None:
            return ()
        return scene.sequence if config.calibration is not None or scene.frame_number is not None else ()

    def __call__(self, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Match one pair: load or rectify, search range, match, save.

        Raises
        ------
        InputError
            The images cannot be used, too few key points match where they give the range, or ``memory`` is too little.
        """
        config, clock, facts, warnings = self.config, Clock(), dict[str, Any](), list[str]()
        matcher, limits = self.matcher(scene), self.limits(memory)
        known = save = None
        if frames := self.range_frames(scene):
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
            found = match_pair(matcher, pair, self.given_range(scene), limits, clock, known)
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
            **self._device_columns(),
        }
        return Outcome(columns, clock.seconds, [*warnings, *found.warnings])

    def _device_columns(self) -> dict[str, str]:
        """Return the device, where the config names one."""
        config, device = self.config, self.device()
        if not isinstance(config, StereoConfig) or config.device == "cpu":
            return {}
        if device is None:
            return {"device": config.device}
        where = f"{device.info.address}, {device.info.name}"
        if device_implementation_of(config.pipeline) is None:
            where = f"cpu: {config.pipeline.method_name()} has no kernels for {where}"
        return {"device": where}


def _unknown_ranges(config: PairConfig, scenes: Sequence[StereoScene], rows: Sequence[Row]) -> list[str]:
    """Return a line with the search range of scenes for which neither the config nor their files give one."""
    if config.max_disparity is not None or config.calibration is not None:
        return []
    unknown = {scene.name for scene in scenes if not scene.problem and scene.max_disparity is None}
    ends = [row["max_disparity"] for row in rows if row["scene"] in unknown and "max_disparity" in row]
    if not ends:
        return []
    which = "the search range is" if len(ends) == 1 else f"the search ranges of {len(ends)} scenes are"
    span = f"{ends[0]}" if len(set(ends)) == 1 else f"{min(ends)} to {max(ends)}"
    return [f"{which} not known: --max-disparity auto was taken, which gives {span} px (max_disparity in report.csv)"]


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
