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

from typing import Annotated

from typer import Option

from depthcli.commands._options import CodingOptions, RangeOptions, ScoredRunOptions
from depthcli.commands._shared_options import BoundOption, ConfigArgument, LevelOption, SetOption, WithinOption
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
    from depthcli.commands._batch import run_batch

    promise = {"level": level, "within": within}
    if config == "maps":
        from depthcli.commands import _fuse_maps

        prepared = _fuse_maps.prepare(maps or [], pairs, coding, run, bound, promise, surfaces, set)
        return run_batch(*prepared, run, pairs)
    if maps:
        raise ConfigError("--maps goes with depthcli fuse maps, not with a config")
    from depthcli.commands._fuse import prepare

    return run_batch(*prepare(config, pairs, run, set, promise if bound else None), run, pairs)
