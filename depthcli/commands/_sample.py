"""What ``sample`` computes: one generated scene with its ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from depthcli.commands._options import SampleOptions
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError
from depthcli.problems.problem import SceneJob, Shown
from depthcli.run.job import Outcome
from depthcli.show.table import SIZE, percent
from depthcli.simulate.samples import SAMPLE_KINDS, SampleScene, sample_scenes

_BY_SCENE = frozenset({"count", "kind", "seed", "from_"})
"""Options that choose scenes and change none beyond its settings."""


def prepare(options: SampleOptions) -> tuple[Sample, list[SampleScene]]:
    """Return the batch that generates scenes of the kind that the options name, and these scenes.

    Raises
    ------
    ConfigError
        Several kinds, or options that the kind does not take or that do not fit together.
    """
    values, defaults = vars(options), {each.name: each.default for each in fields(options)}
    chosen = [name for name in SAMPLE_KINDS if values.get(name)]
    if len(chosen) > 1:
        raise ConfigError(f"--{chosen[0]} and --{chosen[1]} exclude each other".replace("_", "-"))
    name = chosen[0] if chosen else "stereo"
    kind = SAMPLE_KINDS[name]
    for other in {option for each in SAMPLE_KINDS.values() for option in each.options}.difference(kind.options):
        if values[other] not in (defaults[other], []):
            option = other.rstrip("_").replace("_", "-")
            raise ConfigError(f"--{option} has no effect on {name.replace('_', '-')} scenes")
    own = {option: values[option] for option in kind.options}
    config = {"sample": name, **{key: value for key, value in own.items() if key not in _BY_SCENE}}
    return Sample(config), sample_scenes(name, own)


@dataclass(frozen=True)
class Sample(SceneJob[SampleScene]):
    """Generates scenes."""

    command = "sample"
    shown = Shown((SIZE, percent("nonocc", "visible")))

    config: Mapping[str, Any]

    def settings(self, scene: SampleScene) -> dict[str, str]:
        """Return the facts that make the scene, apart from the config."""
        return {key: str(value) for key, value in scene.settings.items()}

    def compute(self, scene: SampleScene, folder: Path, context: Context) -> Outcome:
        """Generate one scene."""
        clock = context.clock
        clock.start("make")
        facts = SAMPLE_KINDS[self.config["sample"]].make(self.config, scene, folder)
        return Outcome(facts, clock.seconds)
