"""Estimates of a registration's errors: the data flow from a registered pair to a map in mm. One file per pipeline."""

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

_CERTAINTY_MM = 3.0  # expected error of which the certainty is 1/e


@dataclass(kw_only=True)
class RegistrationResult(Result):
    """Confidence and expected error of a registration.

    Maps lie on the grid of what was measured: (i, j, k) is at ``start + step * (i, j, k)`` voxels of the fixed volume.

    Attributes
    ----------
    expected_error : (z, y, x) float32, mm
    shift : (3, z, y, x) float32, where the match of a voxel lies, (z, y, x) mm along the volume's axes; None: the
        method looks for no match
    scores : (z, y, x) float32 of each resolution, the finest first, by which a table of errors in voxels of that
        resolution gives the bound, the larger the surer; empty: the method gives no bound
    measures : name -> (z, y, x) float32, of the first feature at full resolution
    step, start : of the working grid, in voxels of the fixed volume, (z, y, x)
    certainty : (z, y, x) float32 in [0, 1]: exp(-expected error / 3 mm)
    """

    expected_error: NDArray[np.float32]
    step: tuple[float, float, float]
    start: tuple[float, float, float]
    shift: NDArray[np.float32] | None = None
    scores: tuple[NDArray[np.float32], ...] = ()
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
    """Return a map, whose (i, j, k) is at ``start + step (i, j, k)`` voxels, at ``shape`` voxels from ``first`` on."""
    back = [1 / each for each in step]
    places = [-a / each + voxel * b for a, each, voxel, b in zip(start, step, first, back, strict=True)]
    return resample(values, shape, back, places)


class RegistrationPipeline(Method):
    """A complete estimate of the errors of one registration; a config names it under the key ``pipeline``."""

    @property
    def voxel_limit(self) -> int | None:
        """Most voxels that volumes are read as, larger ones as means of blocks; None: they are read as they are."""
        return None

    @property
    def error_table(self) -> str:
        """Name of the table of the package that gives bounds by the scores of a result; empty: results have none."""
        return ""

    @abstractmethod
    def __call__(self, pair: RegisteredPair) -> RegistrationResult:
        """Estimate the error at every place of a grid over the fixed volume.

        Returns
        -------
        Finite errors, none of them negative. ``figures``: ``mean_error``, mm; where matches are searched for
        ``border``, the share of them that lie on the border of the search; with scores ``iso``, the side of a voxel of
        the finest resolution, and ``reach``, the largest displacement along an axis of the coarsest search, mm.
        """

    @abstractmethod
    def peak_bytes(self, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> int:
        """Estimate the peak working memory beside two volumes of ``shape`` (z, y, x) and ``spacing`` (mm), bytes."""


Pipeline = Annotated[RegistrationPipeline, *method_of("depthcli.methods.registration.pipeline", key="pipeline")]
