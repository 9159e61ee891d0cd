"""Estimate the errors of given disparity maps.

Every pixel gets an error bound, and the probability that its error is small.

Maps are found in the same way as by evaluate: in run folders of depthcli, or as PFM, PNG, npy and TIFF files of other
programs. --share 0.8 keeps the most certain 80 % of the pixels in disp_left.

Examples:
  depthcli confidence -i scenes --maps runs/raft -o sure --evaluate
  depthcli confidence -i scenes --maps raft -o sure --share 0.8 --measure all
"""

from __future__ import annotations

from typing import Annotated

from typer import Option

from depthcli.commands._options import (
    CodingOptions,
    LevelOption,
    MaxDisparityOption,
    PairOptions,
    ScoredRunOptions,
    WithinOption,
    parse_disparity,
)
from depthcli.core.errors import ConfigError


def confidence(
    pairs: PairOptions,
    run: ScoredRunOptions,
    coding: CodingOptions,
    maps: Annotated[str, Option(metavar="RUN", help="Run folder or map to judge; NAME=DIR names it.")],
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
    share: Annotated[
        float | None,
        Option(metavar="SHARE", min=1e-6, max=1, help="Share of the pixels to keep in disp_left, the most certain."),
    ] = None,
    threshold: Annotated[
        float | None, Option(metavar="P", min=0, max=1, help="Smallest probability of pixels to keep in disp_left.")
    ] = None,
) -> int:
    """Judge the map of every scene; ``--share`` and ``--threshold`` remove unreliable pixels from disp_left."""
    from depthcli.commands._run import run_maps
    from depthcli.io.formats.plain_text import is_number
    from depthcli.problems.given_maps import Confidence, ConfidenceOptions, measures_named

    if is_number(run.keep or ""):
        raise ConfigError(f"--keep takes names of files; the share of the surest pixels is --share {run.keep}")
    if share is not None and threshold is not None:
        raise ConfigError("--share and --threshold exclude each other")
    options = ConfidenceOptions(
        max_disparity=parse_disparity(max_disparity), bound={"level": level, "within": within}, keep=share,
        threshold=threshold, measures=measures_named(measure or [], "--measure"),
    )  # fmt: skip
    return run_maps(Confidence(options), pairs, coding, run, [maps], witness or [], right_maps)
