"""What ``stereo`` and ``fuse`` compute of a pair: load or rectify it, find its range, match it, save it."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from depthcli.api.bounds import with_bound
from depthcli.api.matching import limits_of, match_pair, partly_used
from depthcli.api.results import Disparity
from depthcli.api.rigs import read_rig
from depthcli.commands._batch import config_of
from depthcli.commands._options import SceneOptions
from depthcli.commands._rectified_pairs import calibration_files, check_unit, rectified_pair, sequence_range
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError
from depthcli.core.maps import Status
from depthcli.core.method import parts_of
from depthcli.device import Device
from depthcli.io.formats.images import image_size
from depthcli.io.formats.pictures import STATUS_PALETTE
from depthcli.io.scenes import StereoScene
from depthcli.io.stereo_pairs import load_pair
from depthcli.methods.stereo.config import PairConfig
from depthcli.methods.stereo.matching import host_bytes
from depthcli.methods.stereo.networks import Network
from depthcli.methods.stereo.pipeline.command import Program
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.problems.problem import SceneJob, Shown
from depthcli.run.console import SIZE, number, percent
from depthcli.run.job import Outcome
from depthcli.run.json_csv import Row, median, share

PairConfigT = TypeVar("PairConfigT", bound=PairConfig)

_REASONS = [int(bit) for bit in (Status.OCCLUDED, Status.MISMATCH, Status.OUT_OF_RANGE, Status.NO_DATA)]


def pair_config(
    model: type[PairConfigT],
    config: str,
    pairs: SceneOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    **options: object,
) -> PairConfigT:
    """Return the config with all overrides; ConfigError where it is wrong, or its calibration cannot be read."""
    for key in ("max_disparity", "min_disparity"):
        options[key] = getattr(pairs, key, None)
    files = [str(path) for path in getattr(pairs, "calibration", None) or ()]
    options["calibration"] = files[0] if len(files) == 1 else json.dumps(files) if files else None
    found, unit = config_of(model, config, settings, **options), getattr(pairs, "unit", None)
    if unit is not None:
        check_unit(unit)
        if found.calibration is None:
            raise ConfigError("--unit: there is no calibration; give --calibration FILE, too")
        found = found.model_copy(update={"calibration": found.calibration.model_copy(update={"unit": unit})})
    if found.calibration is not None:
        read_rig(found.calibration)  # one that cannot be read is an error before any scene is opened
    return found


def bound_columns(found: Disparity) -> Row:
    """Return the report's columns of a bound: its median, and the mean probability of a value."""
    if found.bound is None or found.probability is None:
        return {}
    right = found.probability[found.valid]
    return {"median_bound": median(found.bound), "expected_right": share(right) if right.size else None}


@dataclass(frozen=True)
class MatchPairs(SceneJob[StereoScene]):
    """Matches pairs and writes the left view's maps; a command chooses the method."""

    shown = Shown(
        (SIZE, *map(percent, ("density", "measured")), number("median_bound", "{:.3g} px")),
        palette=STATUS_PALETTE,
        # Each reason, alone and filled.
        legend=(0, int(Status.SMOOTHED), *_REASONS, *(bit | int(Status.FILLED) for bit in _REASONS)),
        protocol="middlebury-v2",
    )

    config: PairConfig

    @abstractmethod
    def matcher(self, scene: StereoScene) -> PairMatcher:
        """Return what matches the scene's pair."""

    def device(self) -> Device | None:
        """Return the device to match on, None for the processor."""
        return None

    def device_column(self) -> Row:
        """Return the report's columns of the device."""
        return {}

    def memory(self, scene: StereoScene) -> int | None:
        """Estimate by the left image's size; None if the range comes from the pair itself."""
        return None if any(not isinstance(end, int) for end in self.given_range(scene)) else self._memory(scene)

    def memory_bound(self, scene: StereoScene) -> int | None:
        """Estimate by the left image's size; None for programs, networks, devices and videos: these serve one scene."""
        apart = getattr(self.config, "device", "cpu") != "cpu" or scene.frame_number is not None
        if apart or any(isinstance(part, Network | Program) for part in parts_of(self.config)):
            return None
        return self._memory(scene)

    def _memory(self, scene: StereoScene) -> int:
        """Estimate the bytes of matching a pair over its range, or over the widest one where that is not known."""
        height, width = image_size(scene.left)
        low, top = self.given_range(scene)
        low = low if isinstance(low, int) and top is not None else 1 - width
        top = min(top, width - 1) if isinstance(top, int) else width - 1
        limits = limits_of(self.config, 0, self.device())
        return host_bytes(self.matcher(scene), (height, width), max(top - low, 1), limits)

    def files(self, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair, the calibration that rectifies it, and the frames that give its range."""
        files = scene.input_files | calibration_files(self.config.calibration)
        for k, frame in enumerate(self.range_frames(scene)):
            files |= {f"range_{k}_{role}": file for role, file in frame.input_files.items()}
        return files

    def settings(self, scene: StereoScene) -> dict[str, str]:
        """Return the search range, which may come from a file in the folder of the images."""
        low, top = self.given_range(scene)
        return {"max_disparity": str(top), **({} if low == 0 else {"min_disparity": str(low)})}

    def given_range(self, scene: StereoScene) -> tuple[int | str, int | str | None]:
        """Return the ends of the range that the config, or else the scene, gives.

        Where neither gives the upper one it is "auto", and None for a pair that a calibration rectifies: then both ends
        come from the pair itself.
        """
        low, top = self.config.min_disparity, self.config.max_disparity
        low = scene.min_disparity if low is None else low
        top = scene.max_disparity if top is None else top
        return low, "auto" if top is None and self.config.calibration is None else top

    def range_frames(self, scene: StereoScene) -> tuple[StereoScene, ...]:
        """Return the frames of the scene's sequence that give its range together; none where they do not.

        They give the range of pairs that a calibration rectifies, and of videos, but an end that the user calls "auto"
        comes from each pair by itself.
        """
        config = self.config
        if config.max_disparity is not None or config.min_disparity == "auto" or scene.max_disparity is not None:
            return ()
        return scene.sequence if config.calibration is not None or scene.frame_number is not None else ()

    def compute(self, scene: StereoScene, folder: Path, context: Context) -> Outcome:
        """Match one pair: load or rectify, search range, match, save.

        Raises
        ------
        InputError
            The images cannot be used, too few pixels match for the range, or the memory is too little.
        """
        config, clock, facts, warnings = self.config, context.clock, dict[str, Any](), list[str]()
        matcher, limits = self.matcher(scene), limits_of(config, context.memory, self.device())
        known = saved = None
        if frames := self.range_frames(scene):
            clock.start("range")
            known = sequence_range(config.calibration, frames, context.latest)
        with ThreadPoolExecutor(1) as side_work:  # which starts no thread before it has work
            if config.calibration is None:
                clock.start("load")
                pair = load_pair(scene)
                if scene.right is not None and scene.frame_number is None:
                    context.originals = pair, (scene.left, scene.right)
            else:
                clock.start("rectify")
                rectified = rectified_pair(config.calibration, scene, context.latest)
                pair, facts, warnings = rectified.pair, rectified.facts, rectified.warnings
                saved = side_work.submit(rectified.save, folder)  # while the pair is matched
            found = match_pair(matcher, pair, self.given_range(scene), limits, context, known)
        if config.bound is not None:
            clock.start("bound")
            found = with_bound(found, pair, config.bound, context)
        if saved is not None:
            saved.result()
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
            "density": share(found.valid),
            "measured": share(found.measured),
            **bound_columns(found),
            **({"bits": pair.bits} if partly_used(pair) else {}),
            **{name: float(value) for name, value in found.details.figures.items()},
            **self.device_column(),
        }
        return Outcome(columns, clock.seconds, [*warnings, *found.warnings])

    def notes(self, scenes: Sequence[StereoScene], rows: Sequence[Row]) -> list[str]:
        """Return a line with the search range of scenes for which neither the config nor their files give one."""
        if self.config.max_disparity is not None or self.config.calibration is not None:
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
