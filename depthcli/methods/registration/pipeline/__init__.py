"""Estimates of a registration's errors in mm: the data flow from a registered pair. One file per pipeline."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import resample
from depthcli.core.method import Method, method_of
from depthcli.core.result import Result
from depthcli.core.volumes import RegisteredPair

_CERTAINTY_MM = 3.0  # expected error at which the certainty is 1/e


@dataclass(kw_only=True)
class RegistrationResult(Result):
    """Confidence and expected error of a registration.

    Element (i, j, k) of a map is at ``start + step * (i, j, k)`` voxels of the fixed volume.

    Attributes
    ----------
    expected_error : (z, y, x) float32, mm
    shift : (3, z, y, x) float32, displacement from a voxel to its match, (z, y, x) mm along the volume's axes; None:
        the method searches for no match
    score : (z, y, x) float32, larger is more reliable. An error table in voxels of the search converts it to error
        bounds; None: the method gives no bound
    measures : name -> (z, y, x) float32, of the first feature at full resolution
    step, start : step and start of the maps' grid, in voxels of the fixed volume, (z, y, x)
    certainty : (z, y, x) float32 in [0, 1]: exp(-expected error / 3 mm)
    """

    expected_error: NDArray[np.float32]
    step: tuple[float, float, float]
    start: tuple[float, float, float]
    shift: NDArray[np.float32] | None = None
    score: NDArray[np.float32] | None = None
    measures: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    certainty: NDArray[np.float32] = field(init=False)

    def __post_init__(self) -> None:
        self.certainty = np.exp(-self.expected_error / np.float32(_CERTAINTY_MM))


def at_voxels(
    values: NDArray[np.float32],
    start: Sequence[float],
    step: Sequence[float],
    shape: Sequence[int],
    first: Sequence[int] = (0, 0, 0),
) -> NDArray[np.float32]:
    """Return a map resampled at ``shape`` voxels from ``first`` on; its (i, j, k) is at ``start + step (i, j, k)``."""
    back = [1 / each for each in step]
    places = [-a / each + voxel * b for a, each, voxel, b in zip(start, step, first, back, strict=True)]
    return resample(values, shape, back, places)


class RegistrationPipeline(Method):
    """Base of pipelines that estimate the errors of a registration; a config selects one by the key ``pipeline``."""

    @property
    def voxel_limit(self) -> int | None:
        """Largest number of voxels; larger volumes are read as means of blocks. None: no limit."""
        return None

    @property
    def error_table(self) -> str:
        """Name of the package's table that converts scores to error bounds; empty: results have no score."""
        return ""

    @abstractmethod
    def __call__(self, pair: RegisteredPair) -> RegistrationResult:
        """Estimate the error at every point of a grid over the fixed volume.

        Returns
        -------
        Finite errors >= 0. ``figures`` has ``mean_error``, mm. If the method searches for matches, it has ``border``,
        the share of matches on the border of the search. With a score, it has ``iso``, the side of a voxel that the
        table's errors are in, mm, and ``reach``, mm, the bound from which on bounds are open: the largest displacement
        along an axis of the search that the score is from.
        """

    @abstractmethod
    def peak_bytes(self, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> int:
        """Estimate the peak working memory in bytes, without the two volumes of ``shape`` and ``spacing`` (mm)."""


Pipeline = Annotated[RegistrationPipeline, *method_of("depthcli.methods.registration.pipeline", key="pipeline")]
