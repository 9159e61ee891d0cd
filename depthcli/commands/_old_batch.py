"""Commands that go through a folder scene by scene: what they have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic

from depthcli.commands._flags import FLAGS
from depthcli.commands._old_options import CONFIG, DRY_RUN, EVALUATE, HTML_FLAG, INPUT, OUTPUT, RUN, SELECT
from depthcli.core.method import used_files
from depthcli.core.option import Option
from depthcli.io.scenes import Scene
from depthcli.run.batch import Outcome
from depthcli.run.command import Command, ConfigT, ModelT, SceneT, Values
from depthcli.run.console import Column, Reporter
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    from depthcli.io.formats.pictures import Palette

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
        """Compute scenes, evaluate where requested, print table or JSON; or only list the scenes."""
        from depthcli.commands._batch import run_batch
        from depthcli.commands._options import RunOptions, SceneOptions
        from depthcli.run.batch import Batch

        batch: Any = Batch(
            command=self.name,
            config=config,
            compute=partial(self.compute, config),
            columns=self.columns(),
            files=partial(self.files, config),
            settings=partial(self.settings, config),
            memory=partial(self.memory_of, config),
            notes=partial(self.notes, config, scenes),
            problems=self.problems,
            palette=self.palette(),
            legend=self.legend_values(),
            shown_as=self.shown_as,
            page_columns=self.page_columns(),
            truth_kinds=self.truth_kinds(scenes),
        )
        options = RunOptions(**{f.name: values[f.name] for f in fields(RunOptions) if f.name in values})
        vars(options)["reporter"] = reporter
        source = SceneOptions(**{f.name: values[f.name] for f in fields(SceneOptions) if f.name in values})
        return run_batch(batch, scenes, options, source)


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
