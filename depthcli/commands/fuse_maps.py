"""Fuse disparity maps made before, pixel by pixel.

Typed as ``depthcli fuse maps``. Maps of any programs are found as evaluate finds them; one alone is completed and
corrected.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypedDict

from depthcli.commands._flags import FLAGS
from depthcli.commands._given_maps import (
    CODING,
    PAIR_OPTIONS,
    MapsCommand,
    find_map_scenes,
    largest_of,
    loaded,
    memory_for,
    threshold_of,
)
from depthcli.commands._old_options import DRY_RUN, EVALUATE, HTML_FLAG, INPUT, LAYOUT, NAME, OUTPUT, RUN, SCENES
from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.io.scenes.given_maps import MapsScene
from depthcli.run.batch import Outcome
from depthcli.run.command import Values
from depthcli.run.console import SIZE, Column, Reporter, percent

if TYPE_CHECKING:
    pass


class FuseMapsOptions(TypedDict):
    """Options of a run of ``fuse maps``, as ``run.yaml`` holds them; None: not given."""

    max_disparity: int | None
    within: float
    surfaces: bool


class FuseMapsCommand(MapsCommand[FuseMapsOptions]):
    """``depthcli fuse maps --input SCENES --maps A --maps B --output DIR``."""

    results: ClassVar[tuple[str, ...]] = ("disp_left.*", "status.png", "preview.png", "confidence_*")

    options = (
        INPUT,
        *PAIR_OPTIONS,
        Option("maps", str, "Run folder, or map; repeatable; NAME=DIR names it.", "RUN", repeatable=True,
               required=True, group="Input"),
        *CODING,
        OUTPUT,
        NAME, LAYOUT, SCENES,
        Option("within", float, "Error up to which a value is right, pixels.", "PX", default=1.0),
        Option("surfaces", bool, "Also propose planes of segments; slower.", default=False),
        *RUN,
        EVALUATE,
        HTML_FLAG,
        *FLAGS,
        DRY_RUN,
    )  # fmt: skip

    page = "how_to/judge_maps"
    examples = (
        "depthcli fuse maps -i scenes --maps runs/raft --maps runs/fast -o best",
        "depthcli fuse maps --left l.png --right r.png --maps sgm.pfm -o completed",
    )

    def run(self, values: Values, reporter: Reporter) -> int:
        """Fuse the maps of every scene; return the exit code."""
        from depthcli.methods.given_maps.fusion import MAX_MAPS

        if len(values["maps"]) > MAX_MAPS:
            raise ConfigError(f"--maps: at most {MAX_MAPS} (got {len(values['maps'])})")
        config = FuseMapsOptions(
            max_disparity=largest_of(values), within=threshold_of(values), surfaces=values["surfaces"]
        )
        return self.run_on(config, find_map_scenes(values, reporter, values["maps"]), values, reporter)

    def memory_of(self, config: FuseMapsOptions, scene: MapsScene) -> int | None:
        from depthcli.api.maps import fusion_of

        return memory_for(fusion_of(), scene, config["max_disparity"])

    def columns(self) -> tuple[Column, ...]:
        """Return size, number of maps, share expected to be right, share measured."""
        maps = Column("maps", lambda row: str(row.get("maps", "-")))
        shares = ("expected_right", "measured")
        return (SIZE, maps, *(Column(name.replace("_", " "), percent(name)) for name in shares))

    def compute(self, config: FuseMapsOptions, scene: MapsScene, folder: Path, memory: int) -> Outcome:
        """Fuse the maps of one scene.

        Raises
        ------
        InputError
            The files cannot be used, or ``memory`` is too little.
        """
        import numpy as np

        from depthcli.api.maps import fused, fusion_of
        from depthcli.core.result import Clock

        clock = Clock()
        clock.start("load")
        pair = scene.load()
        maps = {one.run: loaded(one, pair.shape) for one in scene.maps}
        clock.start("other")
        method = fusion_of(config["within"], config["surfaces"])
        found = fused(method, pair, maps, config["max_disparity"] or scene.max_disparity, memory)
        clock.include(found.seconds)
        clock.start("save")
        found.save(folder)
        columns = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": found.search.max_disparity,
            "maps": len(maps),
            "expected_right": round(float(found.confidence["probability"].mean()), 6),
            "measured": round(float(np.mean(found.measured)), 6),
        }
        absent = [f"no map of {run}: fused without it" for run in scene.absent]
        return Outcome(columns, clock.seconds, [*absent, *found.warnings])


COMMAND = FuseMapsCommand()
