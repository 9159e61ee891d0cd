"""The computation of ``confidence``: how sure given disparity maps are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.api.maps import judged, measures_named
from depthcli.commands._given_maps import GivenMaps, find_maps, largest, loaded
from depthcli.commands._options import CodingOptions, PairOptions, ScoredRunOptions
from depthcli.core.bound import Bound
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.maps import Status
from depthcli.io.formats.images import read_image
from depthcli.io.scenes import MapsScene
from depthcli.io.stereo_pairs import load_pair
from depthcli.problems.problem import Shown
from depthcli.run.job import Outcome
from depthcli.run.json_csv import median, share
from depthcli.show.table import SIZE, number, percent
from depthcli.show.view import STATUS_PALETTE


def prepare(
    maps: str,
    witnesses: Sequence[str],
    right_maps: str | None,
    pairs: PairOptions,
    coding: CodingOptions,
    run: ScoredRunOptions,
    max_disparity: str | None,
    promise: Mapping[str, float],
    measures: Sequence[str],
    threshold: float | None,
) -> tuple[Confidence, list[MapsScene], ScoredRunOptions]:
    """Return the batch of ``confidence``, the pairs with their maps, and the options without a share in ``--keep``."""
    try:
        kept = float(run.keep or "")
    except ValueError:  # names of files
        kept = None
    if kept is not None and not 0 < kept <= 1:
        raise ConfigError(f"--keep: expected a share above 0 and up to 1, or names of files (got {run.keep!r})")
    if kept is not None and threshold is not None:
        raise ConfigError("--keep SHARE and --threshold exclude each other")
    try:
        names = measures_named(measures)
    except ConfigError as error:
        raise ConfigError(str(error).replace("measures: ", "--measure: ")) from None
    config: dict[str, Any] = {"max_disparity": largest(max_disparity), "bound": promise}
    config |= {"keep": kept, "threshold": threshold, "measures": names}
    scenes = find_maps(pairs, coding, run, [maps], witnesses, right_maps)
    return Confidence(config), scenes, run if kept is None else replace(run, keep=None)


@dataclass(frozen=True)
class Confidence(GivenMaps):
    """Judges the first map of scenes."""

    command = "confidence"
    shown = Shown(
        (SIZE, *map(percent, ("density", "expected_right", "hidden")), number("median_bound", "{:.3g} px")),
        palette=STATUS_PALETTE,
        protocol="middlebury-v2",
    )

    def compute(self, scene: MapsScene, folder: Path, context: Context) -> Outcome:
        """Load a pair and its maps, judge the first, save it with its confidence."""
        config, clock = self.config, context.clock
        clock.start("load")
        if scene.right is None and len(scene.maps) > 1:
            raise InputError(f"{scene.left.parent}: no right image, without which there are no witnesses")
        images = read_image(scene.left) if scene.right is None else load_pair(scene)
        shape = (images.shape[0], images.shape[1])
        maps = {one.run: loaded(one, shape) for one in scene.maps}
        right = None if scene.right is None or scene.right_map is None else loaded(scene.right_map, shape)
        clock.start("other")
        top = self.max_disparity(scene)
        found = judged(images, maps, top, Bound(**config["bound"]), config["measures"], right, context.memory)
        clock.include(found.seconds)
        clock.start("save")
        found.save(folder, config["keep"], config["threshold"])
        known = np.isfinite(found.values)
        hidden = (found.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
        columns = {
            "width": found.values.shape[1],
            "height": found.values.shape[0],
            "max_disparity": found.max_disparity,
            "density": share(np.isfinite(found.kept(config["keep"], config["threshold"]))),
            "expected_right": share(found.probability[known]) if known.any() else None,
            "hidden": share(hidden),
            "median_bound": median(found.bound),
        }
        absent = [f"no map of {run}: judged without it" for run in scene.absent]
        return Outcome(columns, clock.seconds, [*absent, *found.warnings])
