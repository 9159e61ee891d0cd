"""Estimate how wrong given disparity maps may be.

Every pixel gets a bound of its error, and the probability of a small one.

Maps are found as evaluate finds them: run folders of ours, PFM, PNG, npy and TIFF files of other programs. --keep takes
a share, too: 0.8 leaves the surest 80 % of the pixels in disp_left.

Examples:
  depthcli confidence -i scenes --maps runs/raft -o sure --evaluate
  depthcli confidence -i scenes --maps raft -o sure --keep 0.8 --measure all
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from typer import Option

from depthcli.commands._options import CodingOptions, PairOptions, ScoredRunOptions
from depthcli.commands._shared_options import LevelOption, MaxDisparityOption, WithinOption
from depthcli.core.errors import ConfigError


def confidence(
    pairs: PairOptions,
    run: ScoredRunOptions,
    coding: CodingOptions,
    maps: Annotated[str, Option(metavar="RUN", help="Run folder, or map, that is judged; NAME=DIR names it.")],
    witness: Annotated[
        list[str] | None, Option(metavar="RUN", help="Run folder with maps of another method; repeatable.")
    ] = None,
    right_maps: Annotated[str | None, Option(metavar="RUN", help="Run folder, or map, of the right views.")] = None,
    max_disparity: MaxDisparityOption = None,
    within: WithinOption = 1.0,
    level: LevelOption = 0.9,
    measure: Annotated[
        list[str] | None, Option(metavar="NAME", help="Also write this measure, or all; repeatable.")
    ] = None,
    threshold: Annotated[
        float | None, Option(metavar="P", min=0, max=1, help="Smallest probability of a pixel in disp_left.")
    ] = None,
) -> int:
    """Judge the map of every scene; ``--keep SHARE`` and ``--threshold`` leave doubtful pixels out of disp_left."""
    from depthcli.commands._run import run_maps
    from depthcli.problems.given_maps import Confidence, largest, measures_named

    keep = share_of(run.keep)
    if keep is not None and threshold is not None:
        raise ConfigError("--keep SHARE and --threshold exclude each other")
    options: dict[str, Any] = {"max_disparity": largest(max_disparity), "bound": {"level": level, "within": within}}
    options |= {"keep": keep, "threshold": threshold, "measures": measures_named(measure or [], "--measure")}
    run = run if keep is None else replace(run, keep=None)
    return run_maps(Confidence(options), pairs, coding, run, [maps], witness or [], right_maps)


def share_of(keep: str | None) -> float | None:
    """Return the share that ``--keep`` gives, or None for names of files; ConfigError for no such share."""
    try:
        share = float(keep or "")
    except ValueError:
        return None
    if not 0 < share <= 1:
        raise ConfigError(f"--keep: expected a share above 0 and up to 1, or names of files (got {keep!r})")
    return share
