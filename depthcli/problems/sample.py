"""Write generated scenes, or a real one, with their ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from depthcli.core.context import Context
from depthcli.core.errors import ConfigError
from depthcli.problems.problem import SceneJob, Shown
from depthcli.run.job import Outcome
from depthcli.show.table import SIZE, percent
from depthcli.simulate.samples import SAMPLE_KINDS, SampleScene, sample_scenes

_BY_SCENE = frozenset({"count", "kind", "seed", "from_"})
"""Options that select scenes; scenes have them in their settings."""


@dataclass(frozen=True)
class Sample(SceneJob[SampleScene]):
    """Write scenes."""

    command = "sample"
    shown = Shown((SIZE, percent("nonocc", "visible")))

    config: Mapping[str, Any]

    def settings(self, scene: SampleScene) -> dict[str, str]:
        """Return the scene's own settings, in addition to the config."""
        return {key: str(value) for key, value in scene.settings.items()}

    def compute(self, scene: SampleScene, folder: Path, context: Context) -> Outcome:
        """Write one scene."""
        context.clock.start("make")
        row = SAMPLE_KINDS[self.config["sample"]].make(self.config, scene, folder)
        return Outcome(row, context.clock.seconds)


def sampled(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> tuple[Sample, list[SampleScene]]:
    """Return the job and the scenes for the kind that the options ``values`` name.

    Raise ConfigError for several kinds, options that do not apply to the kind, or contradictory options.
    """
    kinds = [name for name in SAMPLE_KINDS if values.get(name)]
    if len(kinds) > 1:
        raise ConfigError(f"--{kinds[0]} and --{kinds[1]} exclude each other".replace("_", "-"))
    name = kinds[0] if kinds else "stereo"
    options = SAMPLE_KINDS[name].options
    for other in {option for kind in SAMPLE_KINDS.values() for option in kind.options}.difference(options):
        if values[other] not in (defaults[other], []):
            option = other.rstrip("_").replace("_", "-")
            raise ConfigError(f"--{option} has no effect on {name.replace('_', '-')} scenes")
    settings = {option: values[option] for option in options}
    config = {"sample": name, **{key: value for key, value in settings.items() if key not in _BY_SCENE}}
    return Sample(config), sample_scenes(name, settings)
