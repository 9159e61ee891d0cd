"""Fuse several cost measures, or given maps.

With the name maps in place of a config, disparity maps of any programs are fused pixel by pixel; they are found as
evaluate finds them. One alone is completed and corrected.

Examples:
  depthcli fuse accurate --input scenes --output runs/fused --evaluate
  depthcli fuse cross-modal --input color-infrared --output runs/infrared
  depthcli fuse maps -i scenes --maps runs/raft --maps runs/fast -o best
  depthcli fuse maps --left l.png --right r.png --maps sgm.pfm -o completed
"""

from __future__ import annotations

from typing import Annotated, Any

from typer import Option

from depthcli.commands._options import (
    BoundOption,
    CodingOptions,
    ConfigArgument,
    LevelOption,
    RangeOptions,
    ScoredRunOptions,
    SetOption,
    WithinOption,
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
    bound: BoundOption = False,
    level: LevelOption = 0.9,
    within: WithinOption = 1.0,
    surfaces: Annotated[bool, Option("--surfaces", help="With maps: also propose planes of segments; slower.")] = False,
) -> int:
    """Match every pair by fusion of measures, or fuse maps."""
    from depthcli.commands._run import run_maps, run_problem

    promise = {"level": level, "within": within}
    if config != "maps":
        if maps:
            raise ConfigError("--maps goes with depthcli fuse maps, not with a config")
        return run_problem("fuse", config, pairs, run, set, bound=promise if bound else None)
    from depthcli.methods.given_maps.fusion import MAX_MAPS
    from depthcli.problems.given_maps import FuseMaps, largest

    if not 1 <= len(maps or ()) <= MAX_MAPS:
        raise ConfigError(f"--maps: give 1 to {MAX_MAPS} runs or maps (got {len(maps or ())})")
    names = ("calibration", "unit", "fisheye", "cameras", "alpha", "min_disparity")
    unused = [name for name in names if getattr(pairs, name) not in (None, False)]
    if unused or set:
        raise ConfigError(f"--{(unused or ['set'])[0].replace('_', '-')} does not go with fuse maps")
    options: dict[str, Any] = {"max_disparity": largest(pairs.max_disparity), "surfaces": surfaces}
    options |= {"within": within, "bound": promise if bound else None}
    return run_maps(FuseMaps(options), pairs, coding, run, maps or [])
