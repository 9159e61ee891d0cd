"""Generate scenes with exact ground truth, for trying things out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.batch.command import Values
from depthcli.commands._batch import BatchCommand
from depthcli.commands._options import DRY_RUN, OUTPUT, RUN
from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.data.generated.samples import SampleScene, samples

if TYPE_CHECKING:
    from depthcli.batch.console import Column, Reporter
    from depthcli.batch.task import Outcome


class SampleCommand(BatchCommand["Mapping[str, object]", SampleScene]):
    """The same loop as the other commands; its scenes come from the options, not from a folder."""

    @property
    def options(self) -> tuple[Option, ...]:
        """A flag a kind of sample, and what the kinds declare."""
        flags = tuple(Option(n, bool, each.about, default=False) for n, each in samples().items() if n != "stereo")
        own: dict[str, Option] = {}
        for each in samples().values():
            for option in each.options:
                own.setdefault(option.name, option)
        return (OUTPUT, *flags, *own.values(), *RUN, DRY_RUN)

    def run(self, values: Values, reporter: Reporter) -> int:
        """Generate the scenes of the one kind that is asked for."""
        chosen = [name for name in samples() if values.get(name)]
        if len(chosen) > 1:
            raise ConfigError(f"--{chosen[0]} and --{chosen[1]} exclude each other".replace("_", "-"))
        sample = samples()[chosen[0] if chosen else "stereo"]
        for option in (option for each in samples().values() for option in each.options):
            if option not in sample.options and values[option.name] not in (option.default, None, []):
                raise ConfigError(f"{option.flag} says nothing about {sample.name.replace('_', '-')} scenes")
        sample.check(values)
        own = {option.name: values[option.name] for option in sample.options}
        config = {"sample": sample.name, **{key: value for key, value in own.items() if key not in sample.by_scene}}
        return self.run_on(config, list(sample.scenes(own)), values, reporter)

    def settings(self, config: Mapping[str, object], scene: SampleScene) -> dict[str, str]:
        """What the scene is made from."""
        return {key: str(value) for key, value in scene.settings.items()}

    def compute(self, config: Mapping[str, object], scene: SampleScene, folder: Path, memory: int) -> Outcome:
        """Generate one scene."""
        from depthcli.batch.task import Outcome
        from depthcli.core.result import Clock

        clock = Clock()
        facts = samples()[str(config["sample"])].make(config, scene, folder)
        clock.stop("make")
        return Outcome(facts, clock.seconds)

    def columns(self) -> tuple[Column, ...]:
        """Size, and the share of pixels that both cameras see."""
        from depthcli.batch.console import SIZE, Column, percent

        return (SIZE, Column("visible", percent("nonocc")))


COMMAND = SampleCommand()
