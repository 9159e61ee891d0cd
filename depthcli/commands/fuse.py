"""Fuse several cost measures, or given maps.

If the config is the word maps, disparity maps of any programs are fused pixel by pixel. They are found in the same way
as by evaluate. A single map is filled and corrected.

Examples:
  depthcli fuse accurate --input scenes --output runs/fused --evaluate
  depthcli fuse cross-modal --input color-infrared --output runs/infrared
  depthcli fuse maps -i scenes --maps runs/raft --maps runs/fast -o best
  depthcli fuse maps --left l.png --right r.png --maps sgm.pfm -o completed
"""

from __future__ import annotations

from typing import Annotated

from typer import Option

from depthcli.commands._options import (
    BoundOptions,
    CodingOptions,
    ConfigArgument,
    RangeOptions,
    ScoredRunOptions,
    SetOption,
    parse_disparity,
)
from depthcli.core.errors import ConfigError


def fuse(
    config: ConfigArgument,
    pairs: RangeOptions,
    run: ScoredRunOptions,
    coding: CodingOptions,
    set: SetOption = None,
    maps: Annotated[
        list[str] | None, Option(metavar="RUN", help="With maps: run folder, or map; repeatable; NAME=DIR names it.")
    ] = None,
    *,
    bounds: BoundOptions,
    surfaces: Annotated[bool, Option("--surfaces", help="With maps: also propose planes of segments; slower.")] = False,
) -> int:
    """Match every pair by fusion of measures, or fuse maps."""
    from depthcli.commands._run import run_maps, run_problem

    if config != "maps":
        if maps:
            raise ConfigError("--maps goes with depthcli fuse maps, not with a config")
        return run_problem("fuse", config, pairs, run, set, bound=bounds.promise(), **pairs.settings())
    from depthcli.methods.given_maps.fusion import MAX_MAPS
    from depthcli.problems.given_maps import FuseMaps, FuseMapsOptions

    if not 1 <= len(maps or ()) <= MAX_MAPS:
        raise ConfigError(f"--maps: give 1 to {MAX_MAPS} runs or maps (got {len(maps or ())})")
    unused = [key for key, value in pairs.settings().items() if value is not None and key != "max_disparity"]
    if unused or set:
        name = (unused or ["set"])[0].rpartition(".")[2].replace("_", "-")
        raise ConfigError(f"--{name} does not go with fuse maps")
    options = FuseMapsOptions(
        max_disparity=parse_disparity(pairs.max_disparity),
        surfaces=surfaces,
        within=bounds.within,
        bound=bounds.promise(),
    )
    return run_maps(FuseMaps(options), pairs, coding, run, maps or [])
