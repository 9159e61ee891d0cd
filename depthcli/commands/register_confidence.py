"""Estimate the error of a registration of two volumes.

Examples:
  depthcli register-confidence mind --input volumes --output runs/mind
  depthcli register-confidence mind --fixed a.nii.gz --warped b.nii.gz -o one
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from typer import Option

from depthcli.commands._options import RunOptions, SceneOptions, ScoredRunOptions
from depthcli.commands._shared_options import ConfigArgument, SetOption, option

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.io.scenes import VolumePairScene
    from depthcli.problems.registration import Register


@dataclass(frozen=True, kw_only=True)
class VolumeOptions(SceneOptions):
    """Pairs of volumes: a folder of them, or the files of one."""

    single_files: ClassVar[str] = "--fixed FILE and --warped FILE"

    fixed: Path | None = option(None, metavar="FILE", help="Fixed volume, instead of --input.")
    warped: Path | None = option(None, metavar="FILE", help="Moving volume after registration, on the fixed grid.")
    moving: Path | None = option(None, metavar="FILE", help="Moving volume, with --displacement or --transform.")
    displacement: Path | None = option(None, metavar="FILE", help="Displacement field of the registration.")
    transform: Path | None = option(None, metavar="FILE", help="Transform of the registration.")
    apply: str | None = option(None, metavar="WHICH", help="With both files: displacement, transform, or both (ANTs).")
    mask: Path | None = option(None, metavar="FILE", help="Mask of the fixed volume.")


def register_confidence(
    config: ConfigArgument,
    volumes: VolumeOptions,
    run: ScoredRunOptions,
    set: SetOption = None,
    field: Annotated[
        str | None, Option(metavar="NAME", help="Convention of the field: auto, itk, ants, niftyreg, voxels.")
    ] = None,
    level: Annotated[
        float | None,
        Option(metavar="P", min=0.5, max=0.99, help="Share of the errors within the volume bound. Default: 0.9."),
    ] = None,
    within: Annotated[
        float | None,
        Option(metavar="MM", help="Error up to which a voxel is right in the volume probability. Default: 3."),
    ] = None,
    neurological: Annotated[
        bool, Option("--neurological", help="Show the patient's right on the right in pictures.")
    ] = False,
) -> int:
    """Estimate the error of every registration, by a search around every voxel."""
    from depthcli.commands._batch import run_batch

    promise = {"bound.level": level, "bound.within": within}
    prepared = prepare(config, volumes, run, set, field=field, neurological=neurological or None, **promise)
    return run_batch(*prepared, run, volumes)


def prepare(
    config: str,
    volumes: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    **options: Any,
) -> tuple[Register, list[VolumePairScene]]:
    """Return the job with this config, and the pairs that the command line names."""
    from depthcli.commands._batch import config_of
    from depthcli.commands._scenes import find_scenes
    from depthcli.io.layouts.registration import VOLUMES
    from depthcli.problems.registration import Register, RegisterConfidenceConfig

    values = config_of(RegisterConfidenceConfig, config, settings, **options)
    return Register(values), find_scenes(VOLUMES, volumes, run)
