"""Local planes vote for what was not measured, or measured wrongly; message passing chooses among their votes."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.window_planes import RADIUS, window_planes
from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.methods.kinect.choice import CLOSE, choose
from depthcli.methods.kinect.fill import nearest_fill
from depthcli.methods.kinect.holes import hidden_openings
from depthcli.methods.kinect.noise import noise_level
from depthcli.methods.kinect.outcome import measured_disparity, outcome
from depthcli.methods.kinect.outlines import truth_probability
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.result import RefinedDepth
from depthcli.methods.kinect.shadows import left_rims, shadow_belief, shadow_limits
from depthcli.methods.kinect.votes import LEVELS, Evidence, Voters, cast_votes


class PlaneVotes(KinectPipeline):
    """Doubt what was measured beside depth edges, ask the surfaces around, and let neighbors agree.

    1. Suspects: gaps, and measurements that are probably wrong by their place beside depth edges. How far true
       outlines lie inside measured ones is learned from the frame (``depthcli.methods.kinect.outlines``).
    2. Robust planes around every trusted pixel, which are the answer outside the suspects.
    3. Votes of these planes, weighted by color and distance, in a histogram for each suspect: its modes are
       candidates. What a shadow allows counts as far as the frame's gaps behave like shadows.
    4. TRW-S chooses, and all is repeated with the refined map.
    """

    jump: float = Field(5.0, gt=0, description="a step of more than this is a depth edge, multiples of the noise")
    sure: float = Field(0.8, gt=0, lt=1, description="what is right with less probability than this is a suspect")
    least_trust: float = Field(0.4, ge=0, lt=1, description="measurements less probable than this do not vote")
    openings: float | None = Field(
        0.6, gt=0, lt=1, description="probability of a measurement whose color speaks for what lies behind; null: 1"
    )
    shadows: bool = Field(True, description="use that shadows are as wide as the step they lie at")
    candidates: int = Field(4, ge=1, le=8, description="most candidates a pixel")
    sigma_color: float = Field(11.0, gt=0, le=500, description="L1 difference in 8-bit Lab over which votes fade")
    sigma_shadow: float = Field(20.0, gt=0, le=30, description="the same in shadows and where they are behind")
    sigma_space: float = Field(3.0, gt=0, le=30, description="distance over which votes fade, pixels")
    growth: float = Field(0.3, ge=0, le=5, description="more of it a pixel of distance from what can be trusted")
    smoothness: float = Field(0.1, ge=0, description="cost of neighbors that differ by as much as the noise")
    truncation: float = Field(13.0, gt=0, description="largest difference that costs, multiples of the noise")
    iterations: int = Field(5, ge=1, le=100, description="of the message passing")
    passes: int = Field(2, ge=1, le=5, description="how often all is done, each time on the map refined so far")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        known = ~np.isnan(measured)
        lab = np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2LAB), np.uint8)
        noise = noise_level(measured)
        jump = self.jump * noise
        right = truth_probability(lab, measured, jump)
        belief = shadow_belief(measured, jump) if self.shadows else 0.0
        suspect = ~known | (right < self.sure)
        trust = np.where(known & (right > self.least_trust), right, np.float32(0))
        clock.stop("suspects")

        refined = measured
        planes = window_planes(measured, trust, noise)
        limit, beyond = shadow_limits(lab, measured, planes, jump, 3 * noise, belief)
        clock.stop("planes")
        distance = cv2.distanceTransform((trust == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
        local = self.sigma_space + self.growth * distance
        hidden = np.where(known, belief, np.clip(np.log(beyond) / np.log(0.06), 0, 1))
        sigma_space = (local ** (1 - hidden) * self.sigma_shadow**hidden).astype(np.float32)
        for step in range(self.passes):
            voters = [Voters.of(lab, planes, trust, stride) for stride, _ in LEVELS]
            if step == 0 and self.openings is not None:
                opened = hidden_openings(lab, planes, voters[1], known & ~suspect, jump, self.sigma_color)
                right = np.where(opened, np.minimum(right, np.float32(self.openings)), right)
                suspect |= opened
                clock.stop("openings")
            # All but the last pass look at every second pixel of every second row.
            grid = 1 if step == self.passes - 1 else 2
            every = np.s_[::grid, ::grid]
            pixels = np.argwhere(suspect[every]).astype(np.int32)
            rim, bonus = left_rims(measured, planes, jump, belief)
            bonus = np.where(known, bonus * (1 - right), bonus).astype(np.float32)
            evidence = Evidence(limit, beyond, rim, bonus)
            votes = cast_votes(
                grid * pixels, lab, voters, evidence, noise, self.candidates, self.sigma_color, sigma_space
            )
            clock.stop("votes")
            chosen = np.full_like(measured, np.nan)
            chosen[every] = choose(
                pixels, *votes, lab[every], measured[every], right[every], suspect[every], planes.every(grid),
                noise, self.smoothness, self.truncation, self.iterations,
            )  # fmt: skip
            # Where the choice agrees with the measurement, the measurement says more.
            agreed = known & ~(np.abs(chosen - measured) >= np.float32(CLOSE * noise))
            old, old_trust = refined, trust
            refined = np.where(agreed & (~suspect | ~np.isnan(chosen)), measured, chosen)
            trust = (~np.isnan(refined)).astype(np.float32)
            changed = (trust != old_trust) | ((refined != old) & (trust > 0))
            clock.stop("choice")
            planes = window_planes(refined, trust, noise, planes, changed)
            clock.stop("planes")
        fallback = np.isnan(planes.value)
        values = nearest_fill(planes.value)
        sigma = np.maximum(planes.scale, np.float32(noise / (2 * RADIUS + 1)))
        return outcome(frame, values, sigma.astype(np.float32), noise, clock, fallback)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Candidates, messages and weights of every pixel, should all be suspects."""
        return (60 * self.candidates + 200) * shape[0] * shape[1]
