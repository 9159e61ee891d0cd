"""What ``sample`` computes: one generated scene with its ground truth."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from depthcli.commands._batch import run_batch
from depthcli.core.errors import ConfigError
from depthcli.core.result import Clock
from depthcli.run.batch import Batch, Outcome
from depthcli.run.console import SIZE, Column, percent
from depthcli.simulate.samples import Sample, SampleScene
from depthcli.simulate.samples.cross_modal import CrossModalSample
from depthcli.simulate.samples.kinect import KinectSampleKind
from depthcli.simulate.samples.registration import RegistrationSample
from depthcli.simulate.samples.stereo import StereoSample
from depthcli.simulate.samples.transparent import TransparentSample

__all__ = ["KINDS", "prepare", "run_batch"]

KINDS: dict[str, Sample] = {
    kind.name: kind()
    for kind in (StereoSample, CrossModalSample, KinectSampleKind, RegistrationSample, TransparentSample)
}


def prepare(values: Mapping[str, Any], command: Callable[..., int]) -> tuple[Batch[SampleScene], list[SampleScene]]:
    """Return the batch that generates scenes of the kind that the options name, and these scenes.

    Parameters
    ----------
    values : of all options of ``command``, whose defaults those have that a kind does not take

    Raises
    ------
    ConfigError
        Several kinds, or options that the kind does not take or that do not fit together.
    """
    chosen = [name for name in KINDS if values.get(name)]
    if len(chosen) > 1:
        raise ConfigError(f"--{chosen[0]} and --{chosen[1]} exclude each other".replace("_", "-"))
    kind = KINDS[chosen[0] if chosen else "stereo"]
    defaults = {name: each.default for name, each in inspect.signature(command).parameters.items()}
    for name in {option for each in KINDS.values() for option in each.options}.difference(kind.options):
        if values[name] not in (defaults[name], []):
            option = name.rstrip("_").replace("_", "-")
            raise ConfigError(f"--{option} has no effect on {kind.name.replace('_', '-')} scenes")
    kind.check(values)
    own = {name: values[name] for name in kind.options}
    config = {"sample": kind.name, **{key: value for key, value in own.items() if key not in kind.by_scene}}
    batch = Batch(
        command="sample",
        config=config,
        compute=_Make(config),
        columns=(SIZE, Column("visible", percent("nonocc"))),
        settings=lambda scene: {key: str(value) for key, value in scene.settings.items()},
    )
    return batch, list(kind.scenes(own))


@dataclass(frozen=True)
class _Make:
    """Generates one scene."""

    config: Mapping[str, Any]

    def __call__(self, scene: SampleScene, folder: Path, memory: int) -> Outcome:
        clock = Clock()
        clock.start("make")
        facts = KINDS[self.config["sample"]].make(self.config, scene, folder)
        return Outcome(facts, clock.seconds)
