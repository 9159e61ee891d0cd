"""Polynomials of inverse depth, in which a plane has degree 1 (thesis, chapter 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.polynomials import Surfaces, fit_polynomials
from depthcli.methods.kinect.model import SurfaceModel


class Polynomial(SurfaceModel):
    """Polynomials in (x, y), fitted by iteratively reweighted least squares with Huber's weights."""

    degree: int = Field(
        1, ge=0, le=2, description="degree of the polynomial; at most 1 below 100 known pixels, 0 below 30"
    )
    huber: float | None = Field(
        1.345, gt=0, description="k: residuals of u > k scales have weight k / u; null: plain least squares"
    )
    iterations: int = Field(
        20, ge=1, le=100, description="largest number of reweightings without surfaces of a previous frame"
    )
    warm_iterations: int = Field(2, ge=1, le=100, description="reweightings from the surfaces of the previous frame")
    samples: int = Field(400, ge=100, description="largest number of pixels per segment that are used, evenly spread")

    def __call__(
        self, values: NDArray[np.float32], labels: NDArray[np.int32], floor: float, start: Surfaces | None = None
    ) -> Surfaces:
        limits = self.huber or np.inf, self.iterations, self.warm_iterations, self.samples
        return fit_polynomials(values, labels, start, self.degree, *limits, floor)
