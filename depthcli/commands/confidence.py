"""Say how sure disparity maps made before are.

Maps are found as evaluate finds them: run folders of ours, PFM, PNG, npy and TIFF files of other programs.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, TypedDict

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
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option
from depthcli.io.scenes.given_maps import MapsScene
from depthcli.run.batch import Outcome
from depthcli.run.command import Values
from depthcli.run.console import SIZE, Column, Reporter, percent


class ConfidenceOptions(TypedDict):
    """Options of a run of ``confidence``, as ``run.yaml`` holds them; None: not given."""

    max_disparity: int | None
    within: float
    keep: float | None
    threshold: float | None
    measures: list[str]


class ConfidenceCommand(MapsCommand[ConfidenceOptions]):
    """``depthcli confidence --input SCENES --maps RUN --output DIR``."""

    results: ClassVar[tuple[str, ...]] = (
        "confidence.*", "confidence_*", "status.png", "disp_left.*", "preview.png"
    )  # fmt: skip

    options = (
        INPUT,
        *PAIR_OPTIONS,
        Option("maps", str, "Run folder, or map, that is judged; NAME=DIR names it.", "RUN", required=True,
               group="Input"),
        Option("witness", str, "Run folder with maps of another method; repeatable.", "RUN", repeatable=True,
               group="Input"),
        Option("right_maps", str, "Run folder, or map, of the right views.", "RUN", group="Input"),
        *CODING,
        OUTPUT,
        NAME, LAYOUT, SCENES,
        Option("within", float, "Error up to which a value is right, pixels.", "PX", default=1.0),
        Option("measure", str, "Also write this measure, or all; repeatable.", "NAME", repeatable=True),
        Option("keep", str, "Share of the pixels that stay in disp_left, 0.8; or names of files kept.", "SHARE",
               group="Output"),
        Option("threshold", float, "Smallest confidence of a pixel that stays in disp_left.", "P", min_value=0.0,
               max_value=1.0, group="Output"),
        *(option for option in RUN if option.name != "keep"),
        EVALUATE,
        HTML_FLAG,
        *FLAGS,
        DRY_RUN,
    )  # fmt: skip

    page = "how_to/judge_maps"
    examples = (
        "depthcli confidence -i scenes --maps runs/raft -o sure --evaluate",
        "depthcli confidence -i scenes --maps raft -o sure --keep 0.8 --measure all",
    )

    def run(self, values: Values, reporter: Reporter) -> int:
        """Judge the map of every scene; return the exit code."""
        from depthcli.api.maps import judge_of

        share, names = _share(values["keep"])
        if share is not None and values["threshold"] is not None:
            raise ConfigError("--keep SHARE and --threshold exclude each other")
        within, measures = threshold_of(values), list(values["measure"] or [])
        try:
            measures = list(judge_of(within, measures).measures)
        except ConfigError as error:
            raise ConfigError(f"--measure: {str(error).partition(': ')[2]}") from None
        config = ConfidenceOptions(
            max_disparity=largest_of(values), within=within, keep=share, threshold=values["threshold"],
            measures=measures,
        )  # fmt: skip
        right = [values["right_maps"]] if values["right_maps"] else []
        scenes = find_map_scenes(values, reporter, [values["maps"]], values["witness"] or [], right)
        return self.run_on(config, scenes, {**values, "keep": names}, reporter)

    def memory_of(self, config: ConfidenceOptions, scene: MapsScene) -> int | None:
        from depthcli.api.maps import judge_of

        return memory_for(judge_of(), scene, config["max_disparity"])

    def columns(self) -> tuple[Column, ...]:
        """Return size, share of pixels with a value, share expected to be right, share hidden in the right view."""
        return (SIZE, Column("density", percent("density")), Column("expected right", percent("expected_right")),
                Column("hidden", percent("hidden")))  # fmt: skip

    def compute(self, config: ConfidenceOptions, scene: MapsScene, folder: Path, memory: int) -> Outcome:
        """Judge the map of one scene.

        Raises
        ------
        InputError
            The files cannot be used, or ``memory`` is too little.
        """
        import numpy as np

        from depthcli.api.maps import judge, judge_by_one_view, judge_of
        from depthcli.core.maps import Status
        from depthcli.core.result import Clock
        from depthcli.io.formats.images import read_image

        clock = Clock()
        clock.start("load")
        method, top = judge_of(config["within"], config["measures"]), config["max_disparity"] or scene.max_disparity
        if scene.right is None:
            if len(scene.maps) > 1:
                raise InputError(f"{scene.left.parent}: no right image, without which there are no witnesses")
            left = read_image(scene.left)
            shape, values = left.shape[:2], loaded(scene.maps[0], left.shape[:2])
            clock.start("other")
            found = judge_by_one_view(method, left, values, top)
        else:
            pair = scene.load()
            shape, maps = pair.shape, {one.run: loaded(one, pair.shape) for one in scene.maps}
            right = None if scene.right_map is None else loaded(scene.right_map, pair.shape)
            clock.start("other")
            found = judge(method, pair, maps, top, right, memory)
        clock.include(found.seconds)
        clock.start("save")
        found.save(folder, config["keep"], config["threshold"])
        known = np.isfinite(found.values)
        hidden = (found.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
        columns = {
            "width": shape[1],
            "height": shape[0],
            "max_disparity": found.max_disparity,
            "density": round(float(np.isfinite(found.kept(config["keep"], config["threshold"])).mean()), 6),
            "expected_right": round(float(found.probability[known].mean()), 6) if known.any() else None,
            "hidden": round(float(hidden.mean()), 6),
        }
        absent = [f"no map of {run}: judged without it" for run in scene.absent]
        return Outcome(columns, clock.seconds, [*absent, *found.warnings])


def _share(text: str | None) -> tuple[float | None, str | None]:
    """Return ``--keep`` as a share, or else as the names of files."""
    try:
        share = float(text or "")
    except ValueError:
        return None, text
    if not 0 < share <= 1:
        raise ConfigError(f"--keep: want a share above 0 and up to 1, or names of files (got {text!r})")
    return share, None


COMMAND = ConfidenceCommand()
