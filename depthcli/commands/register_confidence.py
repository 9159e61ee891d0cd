"""Tell where a registration of two volumes is doubtful: confidence, expected error and shift of every voxel."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from depthcli.commands._batch import ConfigCommand
from depthcli.core.errors import InputError
from depthcli.data.scenes import Scene
from depthcli.data.scenes.volume_pair import VolumePairScene

if TYPE_CHECKING:
    from depthcli.batch.console import Column
    from depthcli.batch.task import Outcome
    from depthcli.core.volumes import Grid
    from depthcli.methods.registration.config import RegisterConfidenceConfig

_BORDER = 0.2  # share of best matches on the border of the search above which errors are larger than it


class RegisterConfidenceCommand(ConfigCommand["RegisterConfidenceConfig", VolumePairScene]):
    """Searches around every voxel of a registered pair."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (VolumePairScene,)

    def config_model(self) -> type[RegisterConfidenceConfig]:
        """The method and the convention of displacement files."""
        from depthcli.methods.registration.config import RegisterConfidenceConfig

        return RegisterConfidenceConfig

    def memory_of(self, config: RegisterConfidenceConfig, scene: VolumePairScene) -> int:
        """By the header of the fixed volume."""
        return _need(config, *scene.size(config.max_voxels))

    def columns(self) -> tuple[Column, ...]:
        """Size, side of a working voxel, mean expected error, share of best matches on the border."""
        from depthcli.batch.console import Column, percent

        return (
            Column("size", lambda row: f"{row['width']}x{row['height']}x{row['slices']}" if "slices" in row else "-"),
            Column("iso mm", lambda row: f"{row['iso']:.2f}" if "iso" in row else "-"),
            Column("error mm", lambda row: f"{row['mean_error']:.2f}" if "mean_error" in row else "-"),
            Column("border", percent("border")),
        )

    def compute(self, config: RegisterConfidenceConfig, scene: VolumePairScene, folder: Path, memory: int) -> Outcome:
        """Search one pair.

        Raises
        ------
        InputError
            The files cannot be used, or ``memory`` bytes do not suffice.
        """
        from depthcli.batch.task import Outcome
        from depthcli.commands._save_registration import save_registration
        from depthcli.core.memory import show_bytes
        from depthcli.core.result import Clock
        from depthcli.data.formats.volumes import written_suffix

        clock = Clock()
        loaded = scene.load(config.field, config.max_voxels)
        points = scene.landmarks(loaded.grid)
        need = _need(config, loaded.grid, loaded.pair.shape, loaded.pair.spacing)
        if need > memory:
            raise InputError(
                f"needs about {show_bytes(need)} of memory ({' x '.join(map(str, loaded.grid.size))} voxels), "
                f"{show_bytes(memory)} may be used; see --max-memory, --jobs, max_voxels, iso"
            )
        clock.stop("load")
        result = config(loaded.pair)
        clock.stop("other")
        clock.seconds["other"] = max(clock.seconds["other"] - sum(result.seconds.values()), 0.0)
        save_registration(result, loaded, points, folder, written_suffix(scene.fixed))
        clock.stop("save")
        width, height, slices = loaded.grid.size
        facts = {"width": width, "height": height, "slices": slices, **result.figures}
        seconds = {"load": clock.seconds["load"], **result.seconds} | clock.seconds
        return Outcome(facts, seconds, _warnings(result.figures["border"]))


def _need(
    config: RegisterConfidenceConfig, grid: Grid, shape: tuple[int, int, int], spacing: tuple[float, float, float]
) -> int:
    """Estimate of the peak working memory of a pair that is loaded as ``shape`` voxels, bytes."""
    # Beside the search: the pair. Before it: one whole volume as it is read, 2 bytes a voxel and 4 as numbers.
    whole = grid.size[0] * grid.size[1] * grid.size[2]
    need: int = max(config.peak_bytes(shape, spacing) + 8 * shape[0] * shape[1] * shape[2], 6 * whole)
    return need


def _warnings(border: float) -> list[str]:
    if border <= _BORDER:
        return []
    return [
        f"{100 * border:.0f} % of the best matches lie on the border of the search: the registration is off by more "
        "than it reaches; raise levels, radius or iso"
    ]


COMMAND = RegisterConfidenceCommand()
