"""One left view matched with several others: a run for each pair, and their maps fused in inverse depth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.commands._baselines import baselines_of
from depthcli.commands._flags import conditions_of
from depthcli.core.errors import ConfigError
from depthcli.run.command import FLAGGED, SOME_FAILED, Values
from depthcli.run.console import Reporter

if TYPE_CHECKING:
    from depthcli.commands._batch import ConfigCommand
    from depthcli.io.scenes.stereo import StereoScene
    from depthcli.methods.stereo.config import PairConfig

PAIRS = "pairs"
"""Folder in the output, with one run for each pair."""

_ONE_PAIR_OPTIONS = ("shard", "evaluate", "list_scenes", "dry_run")
_PAIR_RUN_VALUES: dict[str, Any] = {"html": False, "flag": [], "fail_flagged": False, "json": False, "keep": None}


@dataclass(frozen=True)
class Camera:
    """A view beside the left one.

    Attributes
    ----------
    number : its place among the views as they were given, from 1
    right : image, pattern, folder or video
    baseline : distance from the left camera, in any unit; negative: on its other side
    """

    number: int
    right: Path
    baseline: float

    @property
    def name(self) -> str:
        """Name of its run."""
        return f"right_{self.number}"


def run_pairs(
    command: ConfigCommand[Any, StereoScene],
    config: PairConfig,
    rights: Sequence[Path],
    values: Values,
    reporter: Reporter,
) -> int:
    """Match the left view with each of the others, then fuse the maps; return the exit code.

    The runs of the pairs are ``OUTPUT/pairs/right_1`` and so on, and ``OUTPUT`` is a run of ``fuse maps``: the
    disparities of the pair with the longest baseline on the first one's side.

    Parameters
    ----------
    config : its search range is that of the first pair; the others' are in proportion to their baselines
    rights : two or more views, in the order of ``--baselines``

    Raises
    ------
    ConfigError
        Not one baseline for each view, too many views, wrong conditions, or options that go with one pair alone.
    """
    from depthcli.commands.fuse_maps import COMMAND as FUSE_MAPS
    from depthcli.methods.given_maps.fusion import MAX_MAPS

    conditions_of(values)
    if len(rights) > MAX_MAPS:
        raise ConfigError(f"--right: at most {MAX_MAPS} views (got {len(rights)})")
    cameras = _cameras(rights, values["baselines"])
    if given := [name for name in _ONE_PAIR_OPTIONS if values.get(name)]:
        raise ConfigError(f"--{given[0].replace('_', '-')} wants one --right alone")
    if config.calibration is not None:
        raise ConfigError("calibration: wants one --right alone: each pair would have a left view of its own")
    if config.axis != "horizontal":
        raise ConfigError("--axis vertical wants one --right alone: match each pair, then fuse maps --baselines")
    for camera in cameras:  # a pattern that fits nothing is an error before anything is computed
        command.find({**values, "right": camera.right}, reporter)
    own = cameras[0].baseline
    ranges = {each.name: _range(config.min_disparity, config.max_disparity, each.baseline / own) for each in cameras}
    failed = False
    for camera in cameras:
        place = {"right": camera.right, "baselines": None, "output": values["output"] / PAIRS / camera.name}
        reporter.info(f"pair {camera.number} of {len(cameras)}: {camera.right}")
        code = command.run({**values, **_PAIR_RUN_VALUES, **place, **ranges[camera.name], "quiet": True}, reporter)
        if code not in (0, SOME_FAILED):
            return code
        failed |= code != 0
        if failed and values["fail_fast"]:
            return SOME_FAILED
    first, *others = sorted(cameras, key=lambda camera: -camera.baseline)
    maps = [f"{each.name}={values['output'] / PAIRS / each.name}" for each in (first, *others)]
    fused: dict[str, Any] = {option.name: option.default for option in FUSE_MAPS.options}
    fused |= {name: value for name, value in values.items() if name in fused}
    baselines = ",".join(repr(each.baseline) for each in (first, *others))
    fused |= {"right": first.right, "maps": maps, "baselines": baselines}
    top = ranges[first.name]["max_disparity"]
    fused |= {"max_disparity": top if str(top).isdigit() else None}
    code = FUSE_MAPS.run({**values, **fused}, reporter)
    if code in (0, SOME_FAILED, FLAGGED):
        reporter.info(f"disparities in {values['output']} are those of the baseline {first.baseline:g}")
    return SOME_FAILED if failed and code in (0, FLAGGED) else code


def _cameras(rights: Sequence[Path], baselines: str | None) -> list[Camera]:
    """Return the cameras; ConfigError where there is no baseline for each, or the first one is negative."""
    if baselines is None:
        raise ConfigError(f"{len(rights)} views on the right: give --baselines, such as 0.3,0.1, one for each")
    lengths = baselines_of(baselines, len(rights), "views")
    return [Camera(k, right, length) for k, (right, length) in enumerate(zip(rights, lengths, strict=True), 1)]


def _range(low: int | str | None, top: int | str | None, ratio: float) -> Mapping[str, str | None]:
    """Return the ends of a pair's search range, as options give them; its baseline is ``ratio`` of the first one's.

    An end in pixels is in proportion; "auto" is by the pair's own key points. On the other side the ends change places.
    """

    def scaled(end: int | str | None, whole: Callable[[float], int]) -> str | None:
        return str(whole(end * ratio)) if isinstance(end, int) else end

    if ratio < 0:
        low, top = "auto" if top is None else top, low or 0
    return {"min_disparity": scaled(low, math.floor), "max_disparity": scaled(top, math.ceil)}
