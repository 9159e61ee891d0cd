"""Rectified pairs with disparity maps that were made before."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Self

from depthcli.io.scenes.stereo import StereoScene

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class GivenMap:
    """One file of a run.

    Attributes
    ----------
    run : name of the run
    path : the file
    scale : codes per pixel; None: as the file's kind says
    invalid : value that stands for none; None: recognized
    """

    run: str
    path: Path
    scale: float | None = None
    invalid: float | None = None

    def load(self) -> NDArray[np.float32]:
        """Return the map, (H, W) float32, pixels, NaN = no value; InputError where it cannot be read.

        Where nothing is said about what stands for no value, a constant at or below 0 that stands alone does, in
        maps of other programs; a warning says so.
        """
        import numpy as np

        from depthcli.io.formats.disparity import lone_constant, read_disparity, read_plane
        from depthcli.io.formats.files import shown, warn

        values = read_disparity(self.path, self.scale)
        if self.invalid is not None:
            values[read_plane(self.path) == np.float32(self.invalid)] = np.nan
        elif not (self.path.parent / "record.json").is_file():  # runs of this program mark what has no value
            constant = lone_constant(values)
            if constant is not None:
                marked = values == np.float32(constant)
                values[marked] = np.nan
                warn(
                    f"{shown(self.path)}: {100 * np.mean(marked):.3g} % of the pixels are {constant:g}: taken as no "
                    "value (--invalid nan keeps them)"
                )
        return values


@dataclass(frozen=True, kw_only=True)
class MapsScene(StereoScene):
    """A pair with maps of its left view.

    Attributes
    ----------
    maps : the maps, in the order of the command line
    right_map : map of the right view, or None
    absent : names of the runs that have no map of this scene
    """

    maps: tuple[GivenMap, ...] = ()
    right_map: GivenMap | None = None
    absent: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        scene: StereoScene,
        maps: tuple[GivenMap, ...],
        right_map: GivenMap | None,
        absent: tuple[str, ...],
        problem: str,
    ) -> Self:
        """Return the scene with its maps; ``problem``: why it cannot be used, or empty."""
        own = {field.name: getattr(scene, field.name) for field in fields(StereoScene)}
        own["problem"] = scene.problem or problem
        return cls(**own, maps=maps, right_map=right_map, absent=absent)

    @property
    def input_files(self) -> dict[str, Path]:
        """The images and the maps."""
        files = {f"map_{k}_{one.run}": one.path for k, one in enumerate(self.maps)}
        more = {} if self.right_map is None else {"right_map": self.right_map.path}
        return super().input_files | files | more
