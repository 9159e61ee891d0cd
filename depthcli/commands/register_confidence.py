"""Estimate the error of a registration of two volumes.

Examples:
  depthcli register-confidence mind --input volumes --output runs/mind
  depthcli register-confidence mind --fixed a.nii.gz --warped b.nii.gz -o one
"""

from __future__ import annotations

from typing import Annotated

from typer import Option

from depthcli.commands._options import ConfigArgument, ScoredRunOptions, SetOption, VolumeOptions


def register_confidence(
    config: ConfigArgument,
    volumes: VolumeOptions,
    run: ScoredRunOptions,
    set: SetOption = None,
    field: Annotated[
        str | None,
        Option("--field", metavar="NAME", help="Convention of the field: auto, itk, ants, niftyreg, voxels."),
    ] = None,
    neurological: Annotated[
        bool, Option("--neurological", help="Show the patient's right on the right in pictures.")
    ] = False,
) -> int:
    """Estimate the error of every registration, by a search around every voxel."""
    from depthcli.commands import _register_confidence

    batch, scenes = _register_confidence.prepare(
        config, volumes, run, set, field=field, neurological=neurological or None
    )
    return _register_confidence.run_batch(batch, scenes, run, volumes)
