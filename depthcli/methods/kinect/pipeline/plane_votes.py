"""Planes around unreliable pixels vote for their disparity; message passing chooses among the candidates."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes, window_planes
from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats, Mask
from depthcli.core.result import DepthResult
from depthcli.methods.kinect import candidates
from depthcli.methods.kinect.candidates import AGREEMENT, LEVELS, OPENING_LEVEL, ExtraVotes, Observed, Voters
from depthcli.methods.kinect.disparity import Measurement, nearest_fill, refined_depth
from depthcli.methods.kinect.gap_filling import UNRELIABLE_COST, fill_gaps
from depthcli.methods.kinect.gap_limits import GAP_FACTOR, GapLimits, shadow_background, shadow_limits
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.pipeline.dsrm import Dsrm
from depthcli.methods.kinect.shadows import SHADOW_SIDES, Shadows, Side


class PlaneVotes(KinectPipeline):
    """Replace unreliable measurements and fill gaps by votes of the planes around.

    1. Select unreliable pixels: gaps, and measurements next to depth edges that are probably incorrect. The distance of
       true outlines from measured ones is estimated from the frame (``kinect.depth_edges``).
    2. Fit a robust plane around every reliable pixel. It is the result there.
    3. Collect the planes' votes, weighted by color and distance, in a histogram for each unreliable pixel. Its modes
       are the candidates. Shadows limit them according to the confidence that the frame's gaps are shadows.
    4. TRW-S chooses a candidate for each pixel. Repeat with the refined map.
    """

    renamed: ClassVar[dict[str, str]] = {
        "sure": "min_probability",
        "least_trust": "min_vote_probability",
        "openings": "opening_probability",
        "growth": "sigma_growth",
        "path_share": "continued_share",
    }

    jump: float = Field(5.0, gt=0, description="a step of more than this is a depth edge, multiples of the noise")
    min_probability: float = Field(
        0.8, gt=0, lt=1, description="measurements with a smaller probability of being correct are unreliable"
    )
    min_vote_probability: float = Field(0.4, ge=0, lt=1, description="measurements less probable than this do not vote")
    opening_probability: float | None = Field(
        0.6,
        gt=0,
        lt=1,
        description="largest probability of measurements where colors show an opening; null: not tested",
    )
    shadows: bool | Side = Field(True, description=SHADOW_SIDES)
    continued_share: float = Field(
        0.3,
        ge=0,
        le=10,
        description="share of the votes for a surface continued into a gap, for paths and for dsrm each",
    )
    candidates: int = Field(4, ge=1, le=8, description="largest number of candidate surfaces per pixel")
    sigma_color: float = Field(11.0, gt=0, le=500, description="L1 difference in 8-bit Lab over which votes fade")
    sigma_shadow: float = Field(20.0, gt=0, le=30, description="distance over which votes fade in shadows, pixels")
    sigma_space: float = Field(3.0, gt=0, le=30, description="distance over which votes fade, pixels")
    sigma_growth: float = Field(0.3, ge=0, le=5, description="growth of sigma_space per pixel from the voters")
    smoothness: float = Field(0.1, ge=0, description="cost of neighbors that differ by as much as the noise")
    truncation: float = Field(13.0, gt=0, description="largest difference that costs, multiples of the noise")
    iterations: int = Field(5, ge=1, le=100, description="number of iterations of the message passing")
    passes: int = Field(2, ge=1, le=5, description="repetitions, each on the map refined so far")

    def __call__(self, frame: RgbdFrame) -> DepthResult:
        clock = Clock()
        clock.start("unreliable")
        measurement = Measurement.of(frame, self.jump, self.min_probability, self.shadows)
        measured, noise, shadows = measurement.disparity, measurement.noise, measurement.shadows
        lab, p_correct, known = measurement.lab, measurement.probability, ~np.isnan(measured)
        unreliable = np.isnan(measurement.reliable)
        trust = np.where(known & (p_correct > self.min_vote_probability), p_correct, np.float32(0))
        clock.start("planes")
        planes = window_planes(measured, trust, noise)
        limits = shadow_limits(lab, measured, planes, measurement.jump, 3 * noise, shadows)
        sigma_space = self._sigma_space(trust, known, limits, shadows)
        clock.start("paths")
        continued = self._continued(frame, measurement, trust, limits, clock)
        if frame.has_color and self.opening_probability is not None:
            clock.start("openings")
            voters = Voters.of(lab, planes, trust, LEVELS[OPENING_LEVEL][0])
            tested = known & ~unreliable
            opened = candidates.hidden_openings(lab, planes, voters, tested, measurement.jump, self.sigma_color)
            p_correct = np.where(opened, np.minimum(p_correct, np.float32(self.opening_probability)), p_correct)
            unreliable |= opened
        evidence, refined = Observed(lab, measured, p_correct, unreliable), measured
        for grid in [2] * (self.passes - 1) + [1]:  # all passes but the last use every second row and column
            clock.start("votes")
            background, share = shadow_background(measured, planes, measurement.jump, shadows)
            share = np.where(known, share * (1 - p_correct), share).astype(np.float32)
            extra = ExtraVotes(
                np.concatenate([background[None], continued.values]), np.concatenate([share[None], continued.shares])
            )
            chosen = self._one_pass(evidence, planes, trust, limits, extra, noise, sigma_space, grid, clock)
            # If choice and measurement agree, the measurement is more exact.
            agreed = known & ~(np.abs(chosen - measured) >= np.float32(AGREEMENT * noise))
            old, old_trust = refined, trust
            refined = np.where(agreed & (~unreliable | ~np.isnan(chosen)), measured, chosen)
            trust = (~np.isnan(refined)).astype(np.float32)
            changed = (trust != old_trust) | ((refined != old) & (trust > 0))
            clock.start("planes")
            planes = window_planes(refined, trust, noise, planes, changed)
        result = refined_depth(frame, nearest_fill(planes.value), noise, clock, np.isnan(planes.value))
        result.figures = shadows.figures()
        return result

    def _continued(
        self, frame: RgbdFrame, measurement: Measurement, trust: Floats, limits: GapLimits, clock: Clock
    ) -> ExtraVotes:
        """Return the surfaces around gaps continued into them, along paths and by DSRM."""
        measured, unreliable = measurement.disparity, np.isnan(measurement.reliable)
        trusted = np.where(trust > 0, measured, np.float32(np.nan))
        possible = np.where(limits.factor < 0.1, limits.value, np.float32(np.inf))
        cost = np.where(unreliable, np.float32(UNRELIABLE_COST), np.float32(0))
        path, _ = fill_gaps(trusted, measurement.lab, None, possible, cost, measurement.noise)
        dsrm, _, _ = Dsrm().surfaces(frame, measurement, clock)
        share = np.where(np.isnan(measured), np.float32(self.continued_share), np.float32(0))
        return ExtraVotes(np.stack([path, dsrm.disparity]), np.stack([share, share]))

    def _one_pass(
        self,
        evidence: Observed,
        planes: WindowPlanes,
        trust: Floats,
        limits: GapLimits,
        extra: ExtraVotes,
        noise: float,
        sigma_space: Floats,
        grid: int,
        clock: Clock,
    ) -> Floats:
        """Return the disparity chosen for unreliable pixels of every ``grid``-th row and column, NaN elsewhere."""
        voters = [Voters.of(evidence.lab, planes, trust, stride) for stride, _ in LEVELS]
        pixels = np.argwhere(evidence.unreliable[::grid, ::grid]).astype(np.int32)
        sigmas = self.sigma_color, sigma_space
        found = candidates.cast_votes(
            grid * pixels, evidence.lab, voters, limits, extra, noise, self.candidates, *sigmas
        )
        clock.start("choice")
        chosen, costs = np.full_like(trust, np.nan), candidates.Costs(noise, self.smoothness, self.truncation)
        chosen[::grid, ::grid] = candidates.choose_candidates(
            pixels, found, planes.every(grid), evidence.every(grid), costs, self.iterations
        )
        return chosen

    def _sigma_space(self, trust: Floats, known: Mask, limits: GapLimits, shadows: Shadows) -> Floats:
        """Return the distance over which votes for a pixel fade, (H, W) float32, pixels."""
        in_shadows = max(shadows.left.confidence, shadows.right.confidence)
        distance = cv2.distanceTransform((trust == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
        local = self.sigma_space + self.sigma_growth * distance
        shadowed = np.where(known, in_shadows, np.clip(np.log(limits.factor) / np.log(GAP_FACTOR), 0, 1))
        return np.asarray(local ** (1 - shadowed) * self.sigma_shadow**shadowed, np.float32)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate the peak working memory in bytes, for a frame of ``shape`` in which every pixel is unreliable."""
        return max((60 * self.candidates + 220) * shape[0] * shape[1], Dsrm().peak_bytes(shape))
