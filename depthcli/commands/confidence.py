"""Estimate how wrong given disparity maps may be.

Every pixel gets a bound of its error, and the probability of a small one.

Maps are found as evaluate finds them: run folders of ours, PFM, PNG, npy and TIFF files of other programs. --keep takes
a share, too: 0.8 leaves the surest 80 % of the pixels in disp_left.

Examples:
  depthcli confidence -i scenes --maps runs/raft -o sure --evaluate
  depthcli confidence -i scenes --maps raft -o sure --keep 0.8 --measure all
"""

from __future__ import annotations

from typing import Annotated

from typer import Option

from depthcli.commands._options import CodingOptions, PairOptions, ScoredRunOptions
from depthcli.commands._shared_options import LevelOption, MaxDisparityOption, WithinOption


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
    from depthcli.commands._batch import run_batch
    from depthcli.commands._confidence import prepare

    promise = {"level": level, "within": within}
    batch, scenes, run = prepare(
        maps, witness or [], right_maps, pairs, coding, run, max_disparity, promise, measure or [], threshold
    )
    return run_batch(batch, scenes, run, pairs)
