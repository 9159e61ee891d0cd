"""What ``register-confidence`` computes of a pair of volumes."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.algorithms.resampling import block_means
from depthcli.api.registration import beyond_search, measured_pair, peak_bytes
from depthcli.commands._batch import config_of
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.commands._scenes import find_scenes
from depthcli.core.context import Context
from depthcli.core.errors import InputError
from depthcli.io.formats.volumes import written_suffix
from depthcli.io.scenes import VolumePairScene
from depthcli.io.scenes.volumes import VOLUMES
from depthcli.io.volume_pairs import LoadedPair, landmarks, load_volumes, loaded_size, region_masks
from depthcli.methods.registration.config import RegisterConfidenceConfig
from depthcli.methods.registration.pipeline import RegistrationResult, at_voxels
from depthcli.problems.problem import SceneJob, Shown
from depthcli.run.console import Column, number, percent
from depthcli.run.job import Outcome
from depthcli.run.json_csv import Row

_NUMBERED = re.compile(r"(.+)_\d+")  # a label without a name


def prepare(
    config: str,
    volumes: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    **options: Any,
) -> tuple[RegisterConfidence, list[VolumePairScene]]:
    """Return the batch of the command with this config, and the pairs that the command line names."""
    found = config_of(RegisterConfidenceConfig, config, settings, **options)
    return RegisterConfidence(found), find_scenes(VOLUMES, volumes, run)


def _size(row: Row) -> str:
    return f"{row['width']}x{row['height']}x{row['slices']}" if "slices" in row else "-"


def _center(row: Row) -> str:
    place = [row.get(f"above_{axis}") for axis in "xyz"]
    return " ".join(f"{value:.0f}" for value in place if isinstance(value, int | float)) or "-"


def _error(key: str, form: str, title: str) -> Column:
    """Return the column of an expected error, as ``> 14`` where it stops at the border of the search."""
    plain = number(key, form, title)
    return Column(title, lambda row: "> " * (key in row and beyond_search(row)) + plain.text(row))


def _bound(row: Row) -> str:
    lower: bool = row.get("at_reach", 0) >= 0.5  # the figure is a median
    return "> " * lower + number("inside_bound", "{:.1f}").text(row)


_COLUMNS = (
    Column("size", _size),
    _error("inside_mean", "{:.2f}", "mean mm"),
    _error("inside_95", "{:.1f}", "95 % mm"),
    _error("inside_max", "{:.1f}", "largest mm"),
    Column("bound mm", _bound),
    number("above_3mm", "{:.1f}", "above 3 mm, mL"),
    Column("center, LPS", _center),
    percent("border", "at border"),
)


@dataclass(frozen=True)
class RegisterConfidence(SceneJob[VolumePairScene]):
    """Computes confidence, expected error and, where matches are searched for, shift of pairs."""

    command = "register-confidence"
    shown = Shown(_COLUMNS, (_COLUMNS[0], *_COLUMNS[3:]), protocol="registration")

    config: RegisterConfidenceConfig

    def memory(self, scene: VolumePairScene) -> int:
        """Estimate by the size in the header of the fixed volume."""
        return peak_bytes(self.config, *loaded_size(scene, self.config.pipeline.voxel_limit))

    def settings(self, scene: VolumePairScene) -> dict[str, str]:
        """Return the names of the labels of label maps."""
        return {"labels": f"{scene.labels}"} if scene.labels else {}

    def compute(self, scene: VolumePairScene, folder: Path, context: Context) -> Outcome:
        """Load the volumes, search around every voxel, save the maps and the figures of regions."""
        config, clock = self.config, context.clock
        clock.start("load")
        loaded = load_volumes(scene, config.field, config.pipeline.voxel_limit)
        warnings, points = [scene.lacks_for_truth] if scene.lacks_for_truth else [], None
        try:
            points = landmarks(scene, loaded.grid)
        except InputError as problem:  # the maps do without
            warnings.append(f"{problem}; no points.csv")
        found = measured_pair(config, loaded, clock, context.memory)
        clock.start("save")
        found.save(folder, written_suffix(scene.fixed), points)
        width, height, slices = loaded.grid.size
        facts: Row = {"width": width, "height": height, "slices": slices, **found.details.figures}
        facts |= _region_figures(found.details, loaded, scene)
        return Outcome(facts, clock.seconds, [*warnings, *found.warnings])

    def is_lower_bound(self, row: Row) -> bool:
        """Return whether the search ends before the errors do."""
        return beyond_search(row)

    def problems(self, rows: Sequence[Row]) -> list[str]:
        """Return a line for each region whose mask could not be used."""
        found = ((row, value) for row in rows for key, value in row.items() if key.startswith("region_error_"))
        return [f"{row['scene']}: left out, as a region: {value}" for row, value in found if value]

    def notes(self, scenes: Sequence[VolumePairScene], rows: Sequence[Row]) -> list[str]:
        """Return a line for each label map of which some pairs have the first label alone, so that it has no number."""
        start = "region_volume_"
        own = {str(row["scene"]): {key.removeprefix(start) for key in row if key.startswith(start)} for row in rows}
        masks = {scene.name: {name for name, _ in scene.regions} for scene in scenes if own.get(scene.name)}
        unmasked = {name for scene, names in own.items() for name in names - masks.get(scene, set())}
        numbered = {found[1] for name in unmasked if (found := _NUMBERED.fullmatch(name))}
        lines = []
        for name in sorted(numbered):
            if alone := [scene for scene, names in own.items() if name in names]:
                others = f" and {len(alone) - 1} more" if len(alone) > 1 else ""
                what = f"mask_{name} has one label in {alone[0]}{others}"
                lines.append(f"{what}: the region {name} there, not {name}_1; name its labels in meta.json")
        return lines


def _region_figures(result: RegistrationResult, loaded: LoadedPair, scene: VolumePairScene) -> dict[str, float | str]:
    """Return figures of the expected error in the regions of a pair, such as organs.

    They are ``region_mean_NAME`` and ``region_95_NAME`` (quantile), mm, and ``region_volume_NAME``, mL, alone
    where a region has no voxel. ``region_error_NAME``: why a mask cannot be used; the others are measured all the same.
    """
    figures: dict[str, float | str] = {}
    if not scene.regions:
        return figures
    error = at_voxels(result.expected_error, result.start, result.step, loaded.pair.shape)
    voxel = math.prod(loaded.grid.spacing) / 1000
    for file, _ in scene.regions:
        try:
            for name, mask in region_masks(scene, file, loaded.grid):
                if f"region_volume_{name}" in figures:
                    twice = f"{scene.folder}: two regions are called {name}: give one of them another name"
                    figures.setdefault(f"region_error_{file}", twice)
                    continue
                chosen = mask
                if max(loaded.blocks) > 1:  # blocks half in the mask; of a small mask, the fullest blocks
                    shares = block_means(mask, loaded.blocks)
                    chosen = (shares > 0) & (shares >= min(0.5, float(shares.max())))
                known = error[chosen]
                figures[f"region_volume_{name}"] = round(int(np.count_nonzero(mask)) * voxel, 4)
                if known.size:
                    figures[f"region_mean_{name}"] = round(float(known.mean(dtype=np.float64)), 4)
                    figures[f"region_95_{name}"] = round(float(np.quantile(known, 0.95)), 4)
        except InputError as problem:
            figures[f"region_error_{file}"] = str(problem)
    return figures
