"""The computation of ``fuse maps``: the best of several given disparity maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from depthcli.api.maps import fused
from depthcli.commands._given_maps import GivenMaps, find_maps, largest, loaded
from depthcli.commands._options import CodingOptions, RangeOptions, RunOptions
from depthcli.core.bound import Bound
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError
from depthcli.io.formats.status import read_status
from depthcli.io.scenes import MapsScene, check_same_size
from depthcli.io.stereo_pairs import load_pair
from depthcli.methods.given_maps.fusion import MAX_MAPS, N_ADDED
from depthcli.problems.problem import Shown
from depthcli.run.job import Outcome
from depthcli.run.json_csv import median, share
from depthcli.show.table import SIZE, number, percent
from depthcli.show.view import STATUS_PALETTE


def prepare(
    maps: Sequence[str],
    pairs: RangeOptions,
    coding: CodingOptions,
    run: RunOptions,
    bound: bool,
    promise: Mapping[str, float],
    surfaces: bool,
    settings: Sequence[str] | None,
) -> tuple[FuseMaps, list[MapsScene]]:
    """Return the batch of ``fuse maps``, and the pairs with their maps."""
    if not 1 <= len(maps) <= MAX_MAPS:
        raise ConfigError(f"--maps: give 1 to {MAX_MAPS} runs or maps (got {len(maps)})")
    unused = [name for name in ("calibration", "unit", "min_disparity") if getattr(pairs, name) is not None]
    if unused or settings:
        raise ConfigError(f"--{(unused or ['set'])[0].replace('_', '-')} does not go with fuse maps")
    config: dict[str, Any] = {"max_disparity": largest(pairs.max_disparity), "surfaces": surfaces}
    config |= {"within": promise["within"], "bound": promise if bound else None}
    return FuseMaps(config), find_maps(pairs, coding, run, maps)


@dataclass(frozen=True)
class FuseMaps(GivenMaps):
    """Fuses the maps of scenes."""

    command = "fuse-maps"
    n_added = N_ADDED
    shown = Shown(
        (
            SIZE,
            number("maps", "{}"),
            *map(percent, ("expected_right", "measured")),
            number("median_bound", "{:.3g} px"),
        ),
        palette=STATUS_PALETTE,
        protocol="middlebury-v2",
    )

    def compute(self, scene: MapsScene, folder: Path, context: Context) -> Outcome:
        """Load a pair and its maps, fuse them, save."""
        clock = context.clock
        clock.start("load")
        pair = load_pair(scene)
        maps = {one.run: loaded(one, pair.shape) for one in scene.maps}
        status = {one.run: read_status(one.status) for one in scene.maps if one.status is not None}
        for name, there in status.items():
            check_same_size(scene.folder / f"status.png of {name}", there.shape, scene.left, pair.shape)
        clock.start("other")
        config = self.config
        promise, bound = Bound(**(config["bound"] or {"within": config["within"]})), config["bound"] is not None
        found = fused(
            pair, maps, self.max_disparity(scene), promise, config["surfaces"], context.memory, status, bound=bound
        )
        clock.include(found.seconds)
        clock.start("save")
        found.save(folder)
        sure = found.confidence["probability"] if found.probability is None else found.probability
        columns = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": found.search.max_disparity,
            "maps": len(maps),
            "expected_right": share(sure),
            **({} if found.bound is None else {"median_bound": median(found.bound)}),
            "measured": share(found.measured),
        }
        absent = [f"no map of {run}: fused without it" for run in scene.absent]
        return Outcome(columns, clock.seconds, [*absent, *found.warnings])
