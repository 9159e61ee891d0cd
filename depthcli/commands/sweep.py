"""Run a config with many settings; compare the results.

Every combination has a run folder of its own, and so have the config's own values where no combination has them.
Finished runs are kept when a sweep is repeated or extended.

Examples:
  depthcli sweep accurate --over optimization.p2=2,4,8 -i scenes -o sweep
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.commands._shared_options import ConfigArgument, HtmlOption, LayoutOption, ScenesOption, SetOption


def sweep(
    config: ConfigArgument,
    over: Annotated[list[str], Option(metavar="KEY=VALUES", help="KEY=2,4,8 or KEY=FIRST:LAST:STEP; repeatable.")],
    input: Annotated[Path, Option("--input", "-i", metavar="DIR", help="Folder of scenes.")],
    run: RunOptions,
    command: Annotated[str, Option(metavar="COMMAND", help="The command of CONFIG.")] = "stereo",
    random: Annotated[int | None, Option(metavar="N", min=1, help="Draw N combinations at random, not all.")] = None,
    seed: Annotated[int, Option(metavar="N", min=0, help="Seed of --random.")] = 0,
    layout: LayoutOption = None,
    scenes: ScenesOption = None,
    set: SetOption = None,
    html: HtmlOption = False,
    html_budget: Annotated[
        str, Option(metavar="SIZE", help="Size of its pictures beyond which they are scaled down.")
    ] = "50MB",
) -> int:
    """Run every combination, evaluate all runs, and print the runs by their figure and the effect of every key."""
    from depthcli.commands._sweep import Sweep
    from depthcli.commands._sweep_axes import combinations, parse_axes

    source, axes = SceneOptions(input=input, layout=layout, scenes=scenes), parse_axes(over)
    chosen = combinations(axes, random, seed)
    return Sweep(command, config, set or [], axes, chosen, source, run).run(html, html_budget)
