"""What the commands that go through a folder scene by scene have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Generic, cast

from depthcli.batch.command import SOME_FAILED, Command, ConfigT, ModelT, Row, SceneT, Values
from depthcli.commands._options import DRY_RUN, EVALUATE, HOW, HTML_FLAG, INPUT, OUTPUT, SELECT
from depthcli.commands.evaluate import evaluate, new_page
from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.data.scenes import Scene

if TYPE_CHECKING:
    from depthcli.batch.making import Outcome, RunOptions
    from depthcli.batch.reporter import Reporter
    from depthcli.batch.tables import Column
    from depthcli.data.formats.pictures import Palette
    from depthcli.evaluation.comparison import EvaluationReport


class BatchCommand(Command, Generic[ConfigT, SceneT]):
    """Goes through scenes one by one, into a run folder."""

    @abstractmethod
    def compute(self, config: ConfigT, scene: SceneT, folder: Path, memory: int) -> Outcome:
        """Compute ``scene`` with at most ``memory`` bytes and write its files into the empty ``folder``."""

    @abstractmethod
    def columns(self) -> tuple[Column, ...]:
        """Columns of the command's table."""

    def files(self, config: ConfigT, scene: SceneT) -> dict[str, Path]:
        """Role -> file whose content the result depends on."""
        return scene.input_files

    def settings(self, config: ConfigT, scene: SceneT) -> dict[str, str]:
        """What else the result depends on, beside the config: facts that the layout found."""
        return {}

    def effort(self, config: ConfigT, scene: SceneT) -> int | None:
        """About how much work an scene is, in any unit, told quickly; None: it follows the size of its files."""
        return None

    def run_on(self, config: ConfigT, scenes: Sequence[SceneT], values: Values, reporter: Reporter) -> int:
        """The batch itself, its table and report; the exit code."""
        if values.get("dry_run"):
            return self._say_plan(config, scenes, values, reporter)
        from depthcli.batch import record
        from depthcli.batch.runner import BUG, run_scenes
        from depthcli.batch.tables import run_table

        options = run_options(values)
        if values["list_scenes"]:
            shard = options.shard
            own = scenes if shard is None else shard.of(scenes, lambda scene: self.effort(config, scene))
            names = [scene.name for scene in own]
            if values["json"]:
                reporter.data(record.to_json({"command": self.name, "scenes": names}))
            else:
                reporter.data("".join(f"{name}\n" for name in names))
            return 0
        if options.shard is not None:
            reporter.info(f"shard {options.shard} of {len(scenes)} scenes")
        rows = run_scenes(self, config, scenes, values["output"], options, reporter)
        self._write_legend(values["output"], rows)
        failed = [row for row in rows if row["status"] == "failed"]
        evaluation = self._evaluation(scenes, values, reporter) if _evaluates(values) else None
        if values["json"]:
            document = record.report_document(self.name, rows)
            if evaluation is not None:
                document["evaluation"] = evaluation.to_dict()
            reporter.data(record.to_json(document))
        elif not values["quiet"] and evaluation is None:
            reporter.data(run_table(rows, self.columns()))
        elif evaluation is not None and not values["quiet"]:
            from depthcli.evaluation.tables import report_text

            reporter.data(report_text(evaluation))
        reporter.info(f"{len(rows) - len(failed)} of {len(rows)} scenes done, in {values['output']}")
        if options.fail_fast and failed:
            return 1 if failed[-1]["error"].startswith(BUG) else SOME_FAILED
        if any(row["error"].startswith(BUG) for row in failed):
            return 1
        return SOME_FAILED if failed or (evaluation is not None and evaluation.failed) else 0

    def memory_of(self, config: ConfigT, scene: SceneT) -> int | None:
        """Estimate of the peak working memory of an scene, bytes, from headers alone; None where there is none."""
        return None

    def _say_plan(self, config: ConfigT, scenes: Sequence[SceneT], values: Values, reporter: Reporter) -> int:
        from depthcli.batch.plan import plan, plan_text
        from depthcli.batch.record import to_json

        document = plan(self, config, scenes, values["output"], self.memory_of, run_options(values))
        reporter.data(to_json(document) if values["json"] else plan_text(document, config))
        return 0

    def palette(self) -> Palette | None:
        """Colors of the status maps that it writes, or None."""
        return None

    def legend_values(self) -> tuple[int, ...] | None:
        """Combinations of bits that the legend shows; None for each bit alone."""
        return None

    def _write_legend(self, output: Path, rows: list[Row]) -> None:
        from depthcli.data.formats.pictures import write_legend

        palette = self.palette()
        if palette is not None and any(row["status"] == "done" for row in rows):
            write_legend(output / "legend.png", palette, self.legend_values())

    def _evaluation(self, scenes: Sequence[SceneT], values: Values, reporter: Reporter) -> EvaluationReport | None:
        if not any(scene.has_truth for scene in scenes):
            reporter.error(f"{values['input']}: no ground truth there, nothing to evaluate")
            return None
        output = values["output"]
        page = new_page(self, {"html_budget": "50MB", **values}, output / "evaluation") if values.get("html") else None
        return evaluate(
            [output], values["input"], output / "evaluation", values["scenes"] or ["*"], values["layout"],
            reporter=reporter, kinds=tuple({type(scene) for scene in scenes}), page=page,
        )  # fmt: skip


class ConfigCommand(BatchCommand[ModelT, SceneT]):
    """``depthcli COMMAND CONFIG --input DIR --output DIR ...``: a config, a folder of scenes, a run folder."""

    kinds: ClassVar[tuple[type[Scene], ...]]
    """Kinds of scene that it reads."""

    @property
    def arguments(self) -> tuple[Option, ...]:
        """The config."""
        return (Option("config", str, "YAML file, or the name of a preset.", "CONFIG", required=True),)

    @property
    def options(self) -> tuple[Option, ...]:
        """What the kinds of scene declare, between what all batches share."""
        own = {option.name: option for kind in self.kinds for option in kind.options}
        return (INPUT, *own.values(), OUTPUT, *SELECT, *HOW, EVALUATE, HTML_FLAG, DRY_RUN)

    @abstractmethod
    def config_model(self) -> type[ModelT]:
        """Model of the config's root."""

    def run(self, values: Values, reporter: Reporter) -> int:
        """Compute every scene, then evaluate where that is asked for; the exit code."""
        run_options(values)  # wrong ones are told before anything is looked at
        config = self.config(values)
        scenes = self.find(values, reporter)
        return self.run_on(config, scenes, values, reporter)

    def find(self, values: Values, reporter: Reporter) -> list[SceneT]:
        """The scenes that the command line means."""
        return cast("list[SceneT]", find_scenes(self.kinds, values, reporter))

    def config(self, values: Values) -> ModelT:
        """The config that the command line means; ConfigError with all that is wrong."""
        from depthcli.batch.presets import find_config, find_preset
        from depthcli.core.config_file import load_config

        settings: list[str | tuple[str, str]] = list(values["set"] or [])
        for option in self.options:
            if option.sets and values[option.name] is not None:
                settings.append((option.flag, f"{option.sets}={values[option.name]}"))
        return load_config(
            self.config_model(),
            find_config(self.name, values["config"]),
            settings,
            lambda name: find_preset(self.name, name),
        )


def find_scenes(kinds: tuple[type[SceneT], ...], values: Values, reporter: Reporter) -> list[SceneT]:
    """The scenes that ``--input``, or the files of a single one, mean.

    Raises
    ------
    ConfigError
        Neither or both are given.
    InputError
        As :func:`depthcli.data.walk.discover_scenes`.
    """
    from depthcli.data.walk import chosen_scenes

    named = next((scenes for kind in kinds if (scenes := kind.named(values))), [])
    patterns = values["scenes"] or ["*"]
    if named:
        if values["input"] is not None:
            raise ConfigError(f"--input and {_single_options(kinds)} exclude each other")
        if _evaluates(values):
            raise ConfigError("--evaluate wants --input: a single scene has no ground truth")
        if values["name"] is None:
            return cast("list[SceneT]", chosen_scenes(named, patterns, "the command line"))
        if len(named) > 1:
            raise ConfigError(f"--name is for a single scene, these are {len(named)}")
        return [_renamed(named[0], values["name"])]
    if values["input"] is None:
        raise ConfigError(f"want --input DIR, or {_single_options(kinds)}")
    if values["name"] is not None:
        raise ConfigError(f"--name is for a single scene, given by {_single_options(kinds)}")
    if _evaluates(values) and values["input"].is_file():
        raise ConfigError(f"{values['input']}: --evaluate wants a folder of scenes, with their ground truth")
    return scenes_at(values["input"], kinds, values["layout"], patterns, reporter)


def scenes_at(
    place: Path, kinds: tuple[type[SceneT], ...], layout: str | None, patterns: Sequence[str], reporter: Reporter
) -> list[SceneT]:
    """The scenes of a folder, or of a table of files."""
    from depthcli.data.pairs import TABLE_SUFFIXES
    from depthcli.data.walk import chosen_scenes, discover_scenes

    if place.is_file() and place.suffix.lower() in TABLE_SUFFIXES:
        found = chosen_scenes(kinds[0].of_table(place), patterns, place)
    else:
        found = discover_scenes(place, kinds, layout, patterns, reporter.info)
    return cast("list[SceneT]", found)  # or broken ones, which are never computed


def _single_options(kinds: Sequence[type[Scene]]) -> str:
    texts = (" and ".join(f"{o.flag} FILE" for o in kind.options if o.type is Path) for kind in kinds)
    return ", or ".join(text for text in texts if text)


def run_options(values: Values) -> RunOptions:
    """How a run is done; ConfigError for a wrong size or part."""
    import os

    from depthcli.batch.making import RunOptions
    from depthcli.batch.resources import parse_bytes
    from depthcli.batch.sharing import parse_shard

    memory = parse_bytes(values["max_memory"]) if values["max_memory"] else None
    shard = parse_shard(values["shard"], os.environ)
    if shard is not None and _evaluates(values):
        raise ConfigError("--evaluate wants all scenes: run depthcli evaluate when all shards are done")
    scheduler = values["scheduler"]
    if scheduler is not None and values["jobs"] != 1:
        raise ConfigError("--jobs and --scheduler exclude each other: a cluster has as many workers as it has")
    keep = tuple(name.strip() for name in (values["keep"] or "").split(",") if name.strip())
    return RunOptions(values["jobs"], values["threads"], memory, values["overwrite"], shard, values["fail_fast"], keep,
                   scheduler)  # fmt: skip


def _evaluates(values: Values) -> bool:
    return bool(values.get("evaluate") or values.get("html"))


def _renamed(scene: SceneT, name: str) -> SceneT:
    from dataclasses import replace

    return replace(scene, name=name)
