"""Expected error and shift of a registered pair, from a search around every voxel (thesis, chapter 7)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from depthcli.algorithms.resampling import gaussian, resample
from depthcli.core.context import Clock
from depthcli.core.volumes import RegisteredPair
from depthcli.kernels.jit import n_threads
from depthcli.methods.registration.feature import Feature
from depthcli.methods.registration.feature.mind import Mind
from depthcli.methods.registration.pipeline import RegistrationPipeline, RegistrationResult
from depthcli.methods.registration.search import (
    COSTLY,
    MEASURES,
    SURER_IF_LARGER,
    CurveMeasures,
    SearchShape,
    search,
    search_bytes,
)

_LENGTHS = ("eshift", "vshift", "shift")  # measures in mm
_CT_BELOW, _CT_RANGE = -500.0, (-1000.0, 400.0)  # volumes with values below are CT, in Hounsfield units: air to bone
_MAX_EXPONENT = 40  # intensities up to 2^40 are not scaled: their squares, 2^80, are well within float32 (2^128)
_PYRAMID_SIGMA = 0.8  # Gaussian before a volume is halved, voxels
# Transition to coarse searches: errors as shares of the finer search's reach, by the coarse and by the finer search.
_COARSE_SHARE, _FINE_SHARE = (0.6, 1.2), (0.8, 1.1)
_GRID_ERROR = math.sqrt(1 / 2)  # error of two volumes on grids: half a voxel along each of three axes, uniform; voxels
_MIN_ERROR = 1 / 16  # floor of the error in scores, voxels; both volumes may be equal
_SCORE_SMOOTHING, _SCORE_RADIUS = 2.0, 5  # smoothing and radius in the presets of the error table, voxels
_STRUCTURED_QUANTILE = 0.8  # quantile of the gradient above which a voxel counts as structured; chosen by hand
_N_BINS, _MIN_PER_BIN = 200, 20  # bins of the isotonic regression, and voxels per bin; chosen by hand


class WorkingGrid(NamedTuple):
    """A grid of cubic voxels over the fixed volume."""

    shape: tuple[int, int, int]  # number of voxels, (z, y, x)
    # side of a voxel, and center of the first one, in voxels of the fixed volume
    step: tuple[float, float, float]
    start: tuple[float, float, float]


class RegistrationSearch(RegistrationPipeline):
    """Search around every voxel for a better match than the registration's; a better match indicates an error."""

    features: tuple[Feature, ...] = Field((Mind(),), min_length=1, max_length=4, description="features to compare")
    iso: float | None = Field(
        None, gt=0, le=100, description="side of a working voxel, mm; null: as many voxels as the fixed volume has"
    )
    max_voxels: int = Field(
        6_000_000,
        ge=1000,
        le=100_000_000,
        description="larger volumes are read as means of blocks; also the limit of working voxels if iso is null",
    )
    intensity_range: tuple[float, float] | None = Field(
        None,
        description="lowest and highest intensity, others are clamped; null: -1000, 400 for CT (values below -500)",
    )
    search: SearchShape = Field("cube", description="displacements: the whole cube, three planes or three axes")
    radius: int = Field(5, ge=1, le=12, description="largest displacement searched, working voxels")
    half_window: int = Field(3, ge=0, le=6, description="half of the window that costs are averaged in, working voxels")
    stride: int = Field(
        2, ge=1, le=4, description="measure every n-th working voxel along each axis, interpolate between them"
    )
    smoothing: float = Field(
        2.0,
        ge=0,
        le=8,
        description="standard deviation of the Gaussian that averages expected errors, working voxels; "
        "narrow likelihoods weigh more",
    )
    sharpness: int = Field(
        10, ge=1, le=40, description="power of the likelihoods: 0.5 / k, k in standard deviations of a curve"
    )
    levels: int = Field(
        1, ge=1, le=3, description="number of resolutions; each further one finds errors twice as large"
    )
    measure: str = Field(
        "eshift",
        description="confidence measure that ranks the voxels; eshift converts a measure without a unit to mm",
    )

    @field_validator("measure")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in MEASURES:
            raise ValueError(f"no measure called {name!r}; one of: {', '.join(MEASURES)}")
        return name

    @field_validator("intensity_range")
    @classmethod
    def _ordered(cls, bounds: tuple[float, float] | None) -> tuple[float, float] | None:
        if bounds is not None and bounds[0] >= bounds[1]:
            raise ValueError("the first bound must be below the second")
        return bounds

    @property
    def voxel_limit(self) -> int | None:
        return self.max_voxels

    @property
    def error_table(self) -> str:
        return f"registration_{self.search}"

    def __call__(self, pair: RegisteredPair) -> RegistrationResult:
        """Search around every voxel, and convert the measures of its cost curve to mm, on the working grid.

        ``figures``: ``border``, the share of voxels of interest whose cheapest displacement is on the border of the
        coarsest search; ``iso``, mm; ``mean_error``, mm; ``reach``, the radius of the finest search, mm. Bounds are
        calibrated for that search alone: where the error exceeds it, they are open.
        """
        clock = Clock()
        clock.start("resample")
        grid = self.grid(pair.shape, pair.spacing)
        iso = grid.step[2] * pair.spacing[2]
        # Features do not depend on the unit of intensities, but the squares of very large or very small intensities
        # exceed the range of float32. Scale them by a power of two, which does not round.
        extremes = np.array([extreme(volume) for volume in (pair.fixed, pair.warped) for extreme in (np.min, np.max)])
        bounds = self.intensity_range or (_CT_RANGE if extremes.min() < _CT_BELOW else (-np.inf, np.inf))
        exponent = math.frexp(np.abs(extremes.clip(*bounds)).max())[1]
        scale = 0 if abs(exponent) <= _MAX_EXPONENT else -exponent
        low, high = (np.float32(bound) for bound in bounds)
        volumes = (volume.clip(low, high) for volume in (pair.fixed, pair.warped))
        fixed, warped = (resample(np.ldexp(volume, scale), *grid) for volume in volumes)
        inside = np.ones(fixed.shape, np.bool_)
        if pair.mask is not None:
            inside = resample(pair.mask.astype(np.float32), *grid) >= 0.5
        fine, coarse = self._searches(fixed, warped, iso, clock)
        clock.start("calibration")
        measured = _every_nth(inside, self.stride)
        measured = measured if measured.any() else np.ones_like(measured)
        error, displacement = self._error(fine, coarse, iso)
        if self.measure not in _LENGTHS:
            sign = np.float32(-1 if self.measure in SURER_IF_LARGER else 1)
            score = np.mean([sign * curves.maps[self.measure] for curves in fine], axis=0)
            structured = structured_voxels(_every_nth(fixed, self.stride), measured)
            error = monotone(gaussian(score, self.smoothing / self.stride), error, structured)
        figures = {
            "iso": round(float(iso), 6),
            "border": round(float((coarse or fine)[-1].border[measured].mean()), 6),
            "mean_error": round(float(error[measured].mean(dtype=np.float64)), 6),
            "reach": round(float(self.radius * iso), 6),
        }
        z, y, x = (step * (self.stride if n > 1 else 1) for step, n in zip(grid.step, grid.shape, strict=True))
        return RegistrationResult(
            expected_error=error,
            shift=displacement,
            score=self._score(fine, iso),
            measures=fine[0].maps,
            step=(z, y, x),
            start=grid.start,
            seconds=clock.seconds,
            figures=figures,
        )

    def _searches(
        self, fixed: NDArray[np.float32], warped: NDArray[np.float32], iso: float, clock: Clock
    ) -> tuple[list[CurveMeasures], list[CurveMeasures]]:
        """Search with every feature at full resolution, and with the first feature at every coarser resolution."""
        fine: list[CurveMeasures] = []
        coarse: list[CurveMeasures] = []
        shape = _every_nth(fixed, self.stride).shape
        volumes = [fixed, warped]
        for level in range(self.levels):
            clock.start("features")
            if level:
                smooth = [gaussian(volume, _PYRAMID_SIGMA) for volume in volumes]
                volumes = [np.ascontiguousarray(each[:: 2 if len(each) > 1 else 1, ::2, ::2]) for each in smooth]
            for feature in self.features if level == 0 else self.features[:1]:
                clock.start("features")
                channels = feature(*volumes)
                clock.start("search")
                half = self.half_window if level == 0 else min(self.half_window, 2)
                curves = search(
                    *channels,
                    iso * 2**level,
                    self.radius,
                    half,
                    self.sharpness,
                    self.search,
                    costly=self.measure in COSTLY,
                    stride=min(self.stride, 2 * half + 1),
                )
                if level == 0:
                    fine.append(curves)
                else:
                    coarse.append(_enlarged(curves, shape, level))
        return fine, coarse

    def grid(self, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> WorkingGrid:
        """Return the working grid of a volume, which starts at the volume's outer faces; an axis of one voxel stays."""
        axes = [a for a in range(3) if shape[a] > 1] or [2]
        iso = self.iso
        if iso is None:
            iso = math.prod(spacing[a] for a in axes) ** (1 / len(axes))
            extent = math.prod(shape[a] * spacing[a] for a in axes)
            iso = max(iso, (extent / self.max_voxels) ** (1 / len(axes)))
        z, y, x = (iso / spacing[a] if a in axes else 1.0 for a in range(3))
        nz, ny, nx = (max(1, math.ceil(n / step - 1e-6)) for n, step in zip(shape, (z, y, x), strict=True))
        return WorkingGrid((nz, ny, nx), (z, y, x), ((z - 1) / 2, (y - 1) / 2, (x - 1) / 2))

    def peak_bytes(self, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> int:
        sizes = self.grid(shape, spacing).shape
        voxels = math.prod(sizes)
        measured = math.prod(-(-n // self.stride) if n > 1 else 1 for n in sizes)
        channels = max(feature.channels for feature in self.features)
        # both volumes on the working grid, a feature during its computation or search, and all maps
        making = 4 * voxels * (channels + 4) + channels * voxels
        searching = search_bytes(sizes, channels, self.radius, self.half_window, self.stride, n_threads())
        kept = (len(self.features) + self.levels - 1) * 17 * 4 * measured
        return 8 * voxels + max(making, searching + 2 * channels * voxels) + kept

    def _error(
        self, fine: list[CurveMeasures], coarse: list[CurveMeasures], iso: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return expected error and displacement, mm; coarse searches replace the fine one where errors exceed it."""
        length = self.measure if self.measure in _LENGTHS else "eshift"
        error = expected_error(fine, length, iso, self.smoothing / self.stride)
        displacement = np.mean([curves.displacement for curves in fine], axis=0)
        for k, curves in enumerate(coarse):
            far = curves.maps[length]
            reach = self.radius * iso * 2**k
            share = _ramp(far / np.float32(reach), *_COARSE_SHARE) * _ramp(error / np.float32(reach), *_FINE_SHARE)
            error = error + share * (far - error)
            displacement = displacement + share * (curves.displacement - displacement)
        return error, displacement

    def _score(self, fine: list[CurveMeasures], iso: float) -> NDArray[np.float32]:
        """Return -log2 of the expected error in voxels, always from the measure ``eshift``."""
        # Without a match, a search with a smaller radius than the table's expects smaller errors.
        doubt = max(1, _SCORE_RADIUS / self.radius)
        error = expected_error(fine, "eshift", iso, _SCORE_SMOOTHING / self.stride)
        return np.asarray(-np.log2(np.maximum(error * np.float32(doubt / iso), np.float32(_MIN_ERROR))), np.float32)


def _ramp(values: NDArray[np.float32], low: float, high: float) -> NDArray[np.float32]:
    """Return 0 below ``low``, 1 above ``high``, and linear shares between."""
    ramp: NDArray[np.float32] = np.clip((values - np.float32(low)) / np.float32(high - low), 0, 1)
    return ramp


def _every_nth(volume: NDArray[Any], stride: int) -> NDArray[Any]:
    """Return every n-th voxel along each axis; axes of one voxel stay as they are."""
    return volume[tuple(slice(None, None, stride if n > 1 else 1) for n in volume.shape)]


def _enlarged(curves: CurveMeasures, shape: tuple[int, ...], times: int) -> CurveMeasures:
    """Return the measures of a search at ``shape`` halved ``times`` times, enlarged to ``shape``."""
    step = [1 / 2**times if n > 1 else 1.0 for n in shape]

    def enlarge(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return resample(values, shape, step, (0.0, 0.0, 0.0))

    return CurveMeasures(
        {name: enlarge(values) for name, values in curves.maps.items()},
        np.stack([enlarge(values) for values in curves.displacement]),
        enlarge(curves.variance),
        enlarge(curves.border.astype(np.float32)) >= 0.5,
    )


def structured_voxels(volume: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Select the fifth of the voxels ``inside`` with the largest gradients; all arrays are (Z, Y, X), masks bool."""
    smooth = gaussian(volume, 1.0)
    square = np.zeros_like(smooth)
    for axis in range(3):
        if smooth.shape[axis] > 1:
            square += np.gradient(smooth, axis=axis).astype(np.float32) ** 2
    structured: NDArray[np.bool_] = inside & (square >= np.quantile(square[inside], _STRUCTURED_QUANTILE))
    return structured


def expected_error(searches: list[CurveMeasures], measure: str, iso: float, sigma: float) -> NDArray[np.float32]:
    """Average a measure in mm over searches and surroundings, weighted by the inverse variance of the displacement.

    The error of a smooth registration is smooth. Curves without texture, or of a feature that does not show it, have
    large variances and so small weights. The error that the sampling grids add is added in quadrature. ``sigma`` is the
    standard deviation of the Gaussian surroundings, in measured voxels; ``iso`` is a voxel's side, mm.
    """
    error, hidden, total = (np.zeros_like(searches[0].variance) for _ in range(3))
    for curves in searches:
        weight = np.reciprocal(curves.variance + np.float32(0.5 * iso**2))
        # Windows that differ by less than half a level of the features are almost equal: their error fades to 0.
        doubt = np.minimum(curves.maps["cost0"] * np.float32(2 * 255), 1)
        error += gaussian(curves.maps[measure] * weight * doubt, sigma)
        hidden += gaussian(weight * doubt, sigma)
        total += gaussian(weight, sigma)
    whole: NDArray[np.float32] = np.hypot(error / total, hidden / total * np.float32(_GRID_ERROR * iso))
    return whole


def monotone(score: NDArray[np.float32], error: NDArray[np.float32], fitted: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the mean of ``error`` (mm) as a non-decreasing function of ``score`` (any unit).

    The ``fitted`` voxels are divided into at most 200 bins of equal counts, and the bins' means are fitted by isotonic
    regression. A small slope makes the result increase strictly with the score, so that its order is kept. Beyond the
    first and last bin the result continues at the mean slope, but not below 0.
    """
    from scipy.optimize import isotonic_regression  # takes long to import

    x, y = score[fitted].astype(np.float64), error[fitted].astype(np.float64)
    order = np.argsort(x, kind="stable")
    groups = np.array_split(order, min(_N_BINS, max(1, len(order) // _MIN_PER_BIN)))
    centers = np.array([x[group].mean() for group in groups])
    means = isotonic_regression([y[group].mean() for group in groups], weights=[len(group) for group in groups]).x
    centers, first = np.unique(centers, return_index=True)
    means = means[first]
    low, high = float(score.min()), float(score.max())
    slope = (means[-1] - means[0]) / (centers[-1] - centers[0]) if len(centers) > 1 else 0.0
    if high > centers[-1]:
        centers, means = np.append(centers, high), np.append(means, means[-1] + slope * (high - centers[-1]))
    if low < centers[0]:
        centers = np.insert(centers, 0, low)
        means = np.insert(means, 0, max(0.0, means[0] - slope * (centers[1] - low)))
    rise = 1e-3 * max(float(means[-1] - means[0]), 1e-3) / max(high - low, 1e-9)
    mapped = np.interp(score, centers, means + rise * (centers - centers[0]))
    result: NDArray[np.float32] = np.maximum(mapped, 0).astype(np.float32)
    return result
