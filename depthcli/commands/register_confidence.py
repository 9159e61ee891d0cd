"""Estimate the error of a registration of two volumes.

Examples:
  depthcli register-confidence mind --input volumes --output runs/mind
  depthcli register-confidence mind --fixed a.nii.gz --warped b.nii.gz -o one
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from typer import Option

from depthcli.commands._options import ConfigArgument, SceneOptions, ScoredRunOptions, SetOption, option


@dataclass(frozen=True, kw_only=True)
class VolumeOptions(SceneOptions):
    """Pairs of volumes: a folder of pairs, or the files of one pair."""

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
        str | None,
        Option(metavar="NAME", help="Convention of the field: auto, itk, ants, niftyreg, positions (SPM), voxels."),
    ] = None,
    level: Annotated[
        float | None,
        Option(metavar="P", min=0.5, max=0.99, help="Share of the errors within the volume bound. Default: 0.9."),
    ] = None,
    within: Annotated[
        float | None,
        Option(metavar="MM", help="Error up to which a voxel is correct in the volume probability. Default: 3."),
    ] = None,
    neurological: Annotated[
        bool, Option("--neurological", help="Show the patient's right on the right in pictures.")
    ] = False,
) -> int:
    """Estimate the error of every registration with a search around every voxel."""
    from depthcli.commands._run import run_problem

    options: dict[str, Any] = {
        "field": field,
        "neurological": neurological or None,
        "bound.level": level,
        "bound.within": within,
    }
    return run_problem("register-confidence", config, volumes, run, set, **options)
