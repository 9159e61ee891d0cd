"""Commands that go through a folder scene by scene: what they have in common."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Generic

from depthcli.commands._flags import FLAGS, conditions_of, exit_code, flags_of
from depthcli.commands._old_options import CONFIG, DRY_RUN, EVALUATE, HTML_FLAG, INPUT, OUTPUT, RUN, SELECT, run_options
from depthcli.core.flags import Condition, Flags
from depthcli.core.method import used_files
from depthcli.core.option import Option
from depthcli.core.text import one_line
from depthcli.io.scenes import Scene
from depthcli.run.batch import Outcome
from depthcli.run.command import Command, ConfigT, ModelT, SceneT, Values
from depthcli.run.console import Column, Reporter, run_table
from depthcli.run.json_csv import Row, to_json

if TYPE_CHECKING:
    from depthcli.evaluation.comparison import EvaluationReport
    from depthcli.io.formats.pictures import Palette
    from depthcli.report.run_without_truth import RunWithoutTruth
    from depthcli.run.task import RunOptions

DEPTH_RESULTS = ("depth.*", "sigma.pfm", "status.png", "preview.png", "confidence_*", "points.ply")
"""Shell patterns of the files that commands write for a map of depth."""


class BatchCommand(Command, Generic[ConfigT, SceneT]):
    """A command that computes scenes one by one, into a run folder."""

    results: ClassVar[tuple[str, ...]] = ()
    """Shell patterns of the files that it writes into a scene's folder: own files there are no surprise at the end."""
    results_note: ClassVar[str] = ""
    """What ``depthcli help outputs`` says behind them."""
    shown_as: ClassVar[str] = ""
    """Protocol of its maps, which says how the page shows them where there is no truth."""

    @abstractmethod
    def compute(self, config: ConfigT, scene: SceneT, folder: Path, memory: int) -> Outcome:
        """Compute ``scene`` with at most ``memory`` bytes and write its files into the empty ``folder``."""

    @abstractmethod
    def columns(self) -> tuple[Column, ...]:
        """Return the columns of the table, beside scene, status, seconds and memory."""

    def page_columns(self) -> tuple[Column, ...]:
        """Return the columns that a page of scenes without truth shows beside its own figures: all, unless fewer."""
        return self.columns()

    def files(self, config: ConfigT, scene: SceneT) -> dict[str, Path]:
        """Return role -> file, for all files whose content the result depends on."""
        return scene.input_files

    def settings(self, config: ConfigT, scene: SceneT) -> dict[str, str]:
        """Return what the result depends on beside the config and files: facts that the layout found."""
        return {}

    def effort(self, config: ConfigT, scene: SceneT) -> int | None:
        """Return an estimate of the computing time in any unit; None: in proportion to the size of its files."""
        return None

    def memory_of(self, config: ConfigT, scene: SceneT) -> int | None:
        """Return an estimate of the peak memory, bytes, from file headers alone; None where there is none."""
        return None

    def truth_kinds(self, scenes: Sequence[SceneT]) -> tuple[type[Scene], ...]:
        """Return the kinds of scene that ``--evaluate`` looks for in the input."""
        return tuple({type(scene) for scene in scenes})

    def palette(self) -> Palette | None:
        """Return the colors of the status maps that the command writes; None: it writes none."""
        return None

    def legend_values(self) -> tuple[int, ...] | None:
        """Return the combinations of status bits that the legend shows; None: each bit alone."""
        return None

    def notes(self, config: ConfigT, scenes: Sequence[SceneT], rows: Sequence[Row]) -> list[str]:
        """Return warnings about a whole run, once its ``rows`` are there."""
        return []

    def problems(self, rows: Sequence[Row]) -> list[str]:
        """Return what could not be done of scenes that are done, a line each; the exit code says that there is some."""
        return []

    def run_on(self, config: ConfigT, scenes: Sequence[SceneT], values: Values, reporter: Reporter) -> int:
        """Compute scenes, evaluate where asked, print table or JSON; or only list the scenes. Return the exit code."""
        options, output = run_options(values), values["output"]
        conditions = conditions_of(values.get("flag"), bool(values.get("fail_flagged")))
        if values.get("dry_run") or values["list_scenes"]:
            self._list(config, scenes, values, options, reporter)
            return 0
        from depthcli.commands._evaluation import print_place, print_tables
        from depthcli.io.formats.pictures import write_legend
        from depthcli.run.presets import preset_of
        from depthcli.run.reports import report_document
        from depthcli.run.run_folder import LEGEND_FILE
        from depthcli.run.runner import run_scenes
        from depthcli.run.task import BUG

        if options.shard is not None:
            reporter.info(f"shard {options.shard} of {len(scenes)} scenes")
        options = replace(options, preset=preset_of(self.name, values.get("config") or "") or self.name)
        rows = run_scenes(self, config, scenes, output, options, reporter)
        for line in self.notes(config, scenes, rows):
            reporter.info(f"warning: {line}")
        for line in (problems := self.problems(rows)):
            reporter.error(line)
        failed = [row for row in rows if row["status"] == "failed"]
        if (palette := self.palette()) is not None and len(failed) < len(rows):
            write_legend(output / LEGEND_FILE, palette, self.legend_values())
        evaluation, page_file, flags = self._evaluation(scenes, rows, values, conditions, reporter)
        if values["json"]:
            document = report_document(self.name, rows)
            document |= flags.to_dict()
            reporter.data(to_json(document if evaluation is None else document | {"evaluation": evaluation.to_dict()}))
        elif evaluation is None and not values["quiet"]:
            reporter.data(run_table(rows, self.columns()))
        elif evaluation is not None:
            print_tables(evaluation, reporter, None, values["quiet"])
        if conditions and not (values["json"] or values["quiet"]):
            reporter.data(flags.text())
        total = len(scenes) if options.shard is None else len(rows)
        reporter.info(f"{len(rows) - len(failed)} of {total} scenes done, in {output}")
        if evaluation is not None:
            print_place(output / "evaluation", reporter)
        elif page_file is not None:
            reporter.info(f"page to open in a browser: {page_file}")
        if any(row["error"].startswith(BUG) for row in (failed[-1:] if options.fail_fast else failed)):
            return 1
        incomplete = failed or problems or (evaluation is not None and evaluation.failed)
        return exit_code(bool(incomplete), flags, bool(values.get("fail_flagged")), values.get("shard"))

    def _list(
        self, config: ConfigT, scenes: Sequence[SceneT], values: Values, options: RunOptions, reporter: Reporter
    ) -> None:
        from depthcli.run.plan import plan_document, plan_text, scenes_of_shard

        if values.get("dry_run"):
            document = plan_document(self, config, scenes, values["output"], self.memory_of, options)
            reporter.data(to_json(document) if values["json"] else plan_text(document, config))
            return
        names = [scene.name for scene in scenes_of_shard(self, config, scenes, options)]
        lines = "".join(f"{one_line(name)}\n" for name in names)
        reporter.data(to_json({"command": self.name, "scenes": names}) if values["json"] else lines)

    def _evaluation(
        self,
        scenes: Sequence[SceneT],
        rows: Sequence[Row],
        values: Values,
        conditions: Sequence[Condition],
        reporter: Reporter,
    ) -> tuple[EvaluationReport | None, Path | None, Flags]:
        """Compare scenes with their truth, and write the page of these and of the others, where requested.

        Returns the evaluation, the page's file, and what the conditions flag.
        """
        if not (values.get("evaluate") or values.get("html")):
            return None, None, flags_of(conditions, rows, reporter)
        from depthcli.commands._evaluation import viewers, write_page
        from depthcli.evaluation.evaluate import PAGE_FILE, evaluate_runs
        from depthcli.io.inputs import local
        from depthcli.report.page import Page

        output, truth = values["output"] / "evaluation", values.get("input")
        in_folder = truth is not None and not os.path.isfile(local(truth))  # pairs of a table have no truth
        scored = [scene for scene in scenes if in_folder and scene.has_truth]
        others = [s for s in scenes if s not in scored]
        shown = self._without_truth(others, rows, values["output"]) if values.get("html") and others else None
        views = viewers(reporter, output, bool(values.get("html")), without_truth=shown)
        if scored:
            report = evaluate_runs(
                [values["output"]], values["input"], output, values["scenes"] or ["*"], values["layout"],
                reporter=reporter, kinds=self.truth_kinds(scenes), viewers=views, conditions=conditions,
                rows={str(row["scene"]): row for row in rows},
            )  # fmt: skip
            return report, output / PAGE_FILE if values.get("html") else None, report.flags
        shows = ": the page shows the maps without scores" if values.get("html") else ", nothing to compare with"
        reporter.info(f"no ground truth in {truth or 'the given files'}{shows}")
        flags = flags_of(conditions, rows, reporter)
        written = any(isinstance(page, Page) and write_page(page, output, flags, reporter) for page in views)
        return None, output / PAGE_FILE if written else None, flags

    def _without_truth(self, scenes: Sequence[SceneT], rows: Sequence[Row], folder: Path) -> RunWithoutTruth:
        """Return what the page shows of scenes without truth; a sequence is shown frame by frame."""
        from depthcli.evaluation.map_files import run_names
        from depthcli.evaluation.protocols import load
        from depthcli.io.scenes.rgbd_sequence import SequenceScene
        from depthcli.report.run_without_truth import RunWithoutTruth

        by_name, shown, row_of = {str(row["scene"]): row for row in rows}, list[Scene](), dict[str, Row]()
        for scene in scenes:
            row = by_name.get(scene.name, {})
            if isinstance(scene, SequenceScene):  # its row has means over the frames
                shown += scene.frames
                row_of |= {frame.name: {key: row.get(key, "") for key in ("status", "error")} for frame in scene.frames}
            else:
                shown.append(scene)
                row_of[scene.name] = row
        (name,) = run_names([folder])
        return RunWithoutTruth(name, folder, load(self.shown_as)(), self.palette(), shown, row_of, self.page_columns())


class ConfigCommand(BatchCommand[ModelT, SceneT]):
    """A batch command with a config: ``depthcli COMMAND CONFIG --input DIR --output DIR ...``."""

    kinds: ClassVar[tuple[type[Scene], ...]]
    """Kinds of scene that the command reads."""

    arguments = (CONFIG,)

    @property
    def options(self) -> tuple[Option, ...]:
        """The options of the kinds of scene, between those of all batch commands."""
        own = {option.name: option for kind in self.kinds for option in kind.options}
        return (INPUT, *own.values(), OUTPUT, *SELECT, *RUN, EVALUATE, HTML_FLAG, *FLAGS, DRY_RUN)

    @abstractmethod
    def config_model(self) -> type[ModelT]:
        """Return the model of the config file."""

    def run(self, values: Values, reporter: Reporter) -> int:
        """Compute every scene, then evaluate where that is asked for; return the exit code."""
        run_options(values)  # wrong ones are reported before any file is read
        conditions_of(values.get("flag"), bool(values.get("fail_flagged")))
        config = self.config(values)
        return self.run_on(config, self.find(values, reporter), values, reporter)

    def find(self, values: Values, reporter: Reporter) -> list[SceneT]:
        """Return the scenes that the command line names."""
        from depthcli.commands._scenes import find_scenes

        return find_scenes(self.kinds, values, reporter)  # type: ignore[arg-type]  # kinds cannot be generic

    def config(self, values: Values) -> ModelT:
        """Return the config with all overrides; ConfigError with all that is wrong."""
        from depthcli.core.config_file import load_config
        from depthcli.run.presets import find_config, find_preset

        settings: list[str | tuple[str, str]] = list(values["set"] or [])
        for option in self.options:
            if option.sets and values[option.name] is not None:
                settings.append((option.flag, f"{option.sets}={values[option.name]}"))
        file = find_config(self.name, values["config"])
        config = load_config(self.config_model(), file, settings, lambda name: find_preset(self.name, name))
        used_files(config)  # missing ones are an error before any scene is opened
        return config

    def files(self, config: ModelT, scene: SceneT) -> dict[str, Path]:
        """Return the files of the scene, and those that the methods of the config use."""
        return scene.input_files | used_files(config)
