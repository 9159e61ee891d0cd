"""Estimate the error of a registration of two volumes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from depthcli.commands._old_batch import ConfigCommand
from depthcli.core.option import Option
from depthcli.io.scenes import Scene
from depthcli.io.scenes.volume_pair import VolumePairScene
from depthcli.run.batch import Outcome
from depthcli.run.command import Values
from depthcli.run.console import Column, Reporter, percent
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    from depthcli.methods.registration.config import RegisterConfidenceConfig

_NUMBERED = re.compile(r"(.+)_\d+")  # a label without a name


class RegisterConfidenceCommand(ConfigCommand["RegisterConfidenceConfig", VolumePairScene]):
    """Estimates the error of a registration, by a search around every voxel or by a program of others."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (VolumePairScene,)
    results: ClassVar[tuple[str, ...]] = ("confidence.*", "expected_error.*", "shift.*", "preview.png", "points.csv")
    results_note: ClassVar[str] = "; no shift.* with pipeline: command"
    shown_as: ClassVar[str] = "registration"

    page = "how_to/registration"
    examples = (
        "depthcli register-confidence mind --input volumes --output runs/mind",
        "depthcli register-confidence mind --fixed a.nii.gz --warped b.nii.gz -o one",
    )

    @property
    def options(self) -> tuple[Option, ...]:
        """The options of all batch commands, and ``--neurological``."""
        about = "Show the patient's right on the right in pictures."
        given = (replace(o, help="Folder of scenes.") if o.name == "input" else o for o in super().options)
        return (*given, Option("neurological", bool, about, default=False, group="Output"))

    def run(self, values: Values, reporter: Reporter) -> int:
        """Measure every pair; ``--neurological`` overrides the key of the config. Return the exit code."""
        settings = [*(values["set"] or ()), *(["neurological=true"] if values["neurological"] else ())]
        return super().run({**values, "set": settings}, reporter)

    def config_model(self) -> type[RegisterConfidenceConfig]:
        from depthcli.methods.registration.config import RegisterConfidenceConfig

        return RegisterConfidenceConfig

    def memory_of(self, config: RegisterConfidenceConfig, scene: VolumePairScene) -> int:
        from depthcli.api.registration import peak_bytes

        return peak_bytes(config, *scene.size(config.pipeline.voxel_limit))

    def settings(self, config: RegisterConfidenceConfig, scene: VolumePairScene) -> dict[str, str]:
        """Return the names of the labels of label maps."""
        return {"labels": f"{scene.labels}"} if scene.labels else {}

    def problems(self, rows: Sequence[Row]) -> list[str]:
        """Return a line for each region whose mask could not be used."""
        start = "region_error_"
        found = ((row, value) for row in rows for key, value in row.items() if key.startswith(start))
        return [f"{row['scene']}: left out, as a region: {value}" for row, value in found if value]

    def notes(
        self, config: RegisterConfidenceConfig, scenes: Sequence[VolumePairScene], rows: Sequence[Row]
    ) -> list[str]:
        """Return a line for each label map of which some pairs hold the first label alone, so that it has no number."""
        start = "region_volume_"
        own = {str(row["scene"]): {key.removeprefix(start) for key in row if key.startswith(start)} for row in rows}
        masks = {scene.name: {name for name, _ in scene.regions} for scene in scenes if own.get(scene.name)}
        numbered = {
            found[1]
            for scene, names in own.items()
            for name in names - masks.get(scene, set())
            if (found := _NUMBERED.fullmatch(name))
        }
        lines = []
        for name in sorted(numbered):
            if alone := [scene for scene, names in own.items() if name in names]:
                others = f" and {len(alone) - 1} more" if len(alone) > 1 else ""
                what = f"mask_{name} holds one label in {alone[0]}{others}"
                lines.append(f"{what}: the region {name} there, not {name}_1; name its labels in meta.json")
        return lines

    def columns(self) -> tuple[Column, ...]:
        """Return size, expected error in the mask or body, where it is large, and share of matches on the border."""

        def number(title: str, key: str) -> Column:
            return Column(title, lambda row: f"{row[key]:.1f}" if key in row else "-")

        return (
            Column("size", lambda row: f"{row['width']}x{row['height']}x{row['slices']}" if "slices" in row else "-"),
            Column("mean mm", lambda row: f"{row['inside_mean']:.2f}" if "inside_mean" in row else "-"),
            number("95 % mm", "inside_95"),
            number("largest mm", "inside_max"),
            number("above 3 mm, mL", "above_3mm"),
            Column("center, LPS", _center),
            Column("at border", percent("border")),
        )

    def page_columns(self) -> tuple[Column, ...]:
        """Return the columns without mean and quantile, which the page has of its own."""
        return tuple(column for column in self.columns() if column.title not in ("mean mm", "95 % mm"))

    def compute(self, config: RegisterConfidenceConfig, scene: VolumePairScene, folder: Path, memory: int) -> Outcome:
        """Compute confidence, expected error and, where matches are searched for, shift of one pair.

        Raises
        ------
        InputError
            The files cannot be used, or ``memory`` bytes do not suffice.
        """
        from depthcli.api.registration import check_voxels, measured_pair, region_figures
        from depthcli.core.result import Clock
        from depthcli.io.formats.volumes import written_suffix

        clock = Clock()
        clock.start("load")
        loaded = scene.load(config.field, config.pipeline.voxel_limit)
        points = scene.landmarks(loaded.grid)
        check_voxels(config, loaded, memory)
        found = measured_pair(config, loaded, clock)
        clock.start("save")
        found.save(folder, written_suffix(scene.fixed), points)
        width, height, slices = loaded.grid.size
        facts: Row = {"width": width, "height": height, "slices": slices, **found.details.figures}
        facts |= region_figures(found.details, loaded, scene)
        return Outcome(facts, clock.seconds, list(found.warnings))


def _center(row: Row) -> str:
    place = [row.get(f"above_{axis}") for axis in "xyz"]
    return " ".join(f"{value:.0f}" for value in place if isinstance(value, int | float)) or "-"


COMMAND = RegisterConfidenceCommand()
