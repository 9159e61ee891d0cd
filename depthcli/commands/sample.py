"""Generate scenes with exact ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from depthcli.commands._old_batch import BatchCommand
from depthcli.commands._old_options import DRY_RUN, OUTPUT, RUN
from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.core.registry import with_package
from depthcli.run.batch import Outcome
from depthcli.run.command import Values
from depthcli.run.console import SIZE, Column, Reporter, percent
from depthcli.simulate.samples import SampleScene, samples


class SampleCommand(BatchCommand["Mapping[str, object]", SampleScene]):
    """``depthcli sample``: generates scenes with exact truth into a run folder."""

    results: ClassVar[tuple[str, ...]] = ("*.png", "*.pfm", "*.nii.gz", "meta.json", "calib.json")

    page = "tutorial"
    examples = (
        "depthcli sample --output scenes --count 4 --noise 2",
        "depthcli sample --kinect --output frames",
    )

    @property
    def options(self) -> tuple[Option, ...]:
        """The options of stereo scenes, then for each other kind of sample its flag and the options that it adds."""
        own: dict[str, Option] = {}
        for name, sample in sorted(samples().items(), key=lambda item: item[0] != "stereo"):
            if name != "stereo":
                own[name] = Option(name, bool, with_package(type(sample), sample.about), default=False)
            for option in sample.options:
                own.setdefault(option.name, option)
        return (OUTPUT, *(replace(each, group="Scenes") for each in own.values()), *RUN, DRY_RUN)

    def run(self, values: Values, reporter: Reporter) -> int:
        """Generate the scenes of one kind; return the exit code."""
        chosen = [name for name in samples() if values.get(name)]
        if len(chosen) > 1:
            raise ConfigError(f"--{chosen[0]} and --{chosen[1]} exclude each other".replace("_", "-"))
        sample = samples()[chosen[0] if chosen else "stereo"]
        for option in (option for each in samples().values() for option in each.options):
            if option not in sample.options and values[option.name] not in (option.default, None, []):
                raise ConfigError(f"{option.flag} has no effect on {sample.name.replace('_', '-')} scenes")
        sample.check(values)
        own = {option.name: values[option.name] for option in sample.options}
        config = {"sample": sample.name, **{key: value for key, value in own.items() if key not in sample.by_scene}}
        return self.run_on(config, list(sample.scenes(own)), values, reporter)

    def settings(self, config: Mapping[str, object], scene: SampleScene) -> dict[str, str]:
        return {key: str(value) for key, value in scene.settings.items()}

    def compute(self, config: Mapping[str, object], scene: SampleScene, folder: Path, memory: int) -> Outcome:
        """Generate one scene with its ground truth."""
        from depthcli.core.result import Clock

        clock = Clock()
        clock.start("make")
        facts = samples()[str(config["sample"])].make(config, scene, folder)
        return Outcome(facts, clock.seconds)

    def columns(self) -> tuple[Column, ...]:

        return (SIZE, Column("visible", percent("nonocc")))


COMMAND = SampleCommand()
