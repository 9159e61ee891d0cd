"""Adjustment of a pair before matching: noise, small errors of rows, and different light.

Real pairs are rectified to a fraction of a pixel, and taken by two cameras or one after the other. The errors of rows
and light vary smoothly over the image, so a match at a reduced size is enough to measure them. Once they are
corrected, no matching cost has to tolerate them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal, Self, cast

import cv2
import numpy as np
from pydantic import BaseModel, Field

from depthcli.core.context import Clock, Context
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import Floats
from depthcli.methods.stereo.adjustment.noise import denoised
from depthcli.methods.stereo.adjustment.right_view import (
    BLOCK,
    IDENTITY,
    Correction,
    estimate_gains,
    estimate_row_shift,
    light_trust,
)
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.stages import quick_stages

Adjust = Annotated[
    tuple[Literal["noise", "rows", "light"], ...],
    Field(
        max_length=3,
        description="adjustments before matching: noise (strong noise of both images is averaged away), rows of the "
        "right image (imperfect rectification), light of the right image (exposure, lamps)",
    ),
]

# The match at the reduced size takes about a tenth of the time of `stereo accurate`.
_MAX_PIXELS, _MAX_COSTS = 1 << 17, 1 << 24
_STAGES = quick_stages(SpeckleFilter(size=50), Subpixel())
_MIN_DISPARITIES = 3  # with one or two, the left-right check rejects nothing
_MIN_MATCHES = 500  # enough for 6 coefficients and for gains that vary over the image
_MIN_SHARE_OF_MATCHES = 0.9  # of the most matches so far: fewer mean that the last correction made the pair worse
_MAX_PASSES = 4
_REMATCH_THRESHOLD = 0.3  # rows of the reduced size, summed over coefficients; census costs tolerate smaller changes


def adjusted(
    pair: StereoPair, max_disparity: int, what: Adjust, context: Context | None = None, clock: Clock | None = None
) -> StereoPair:
    """Return the pair without noise, with the rows and the light of its right image adjusted to the left one.

    ``noise``: see :func:`.noise.denoised`. ``rows`` and ``light`` are measured on matches at a reduced size (census,
    scanlines). ``rows``: the vertical shift is a polynomial of the second degree over the image, fitted so that the
    grey levels of matches differ least (robustly weighted Gauss-Newton steps). Cubic interpolation along the columns
    removes it. After a large shift, the corrected pair is matched again. ``light``: every channel is multiplied by the
    local ratio of the left to the right grey levels of matches. The remaining differences give the pair's
    ``light_trust``. Only ``noise`` changes the left image. Disparities, at most ``max_disparity``, do not change.
    ``clock`` receives the seconds as stage "adjustment". ``context`` keeps the result for the next matcher of the pair.
    """
    if not what:
        return pair
    context = context or Context()
    (clock or context.clock).start("adjustment")
    key = id(pair), (max_disparity, what)
    if key not in context.adjusted:
        context.adjusted[key] = pair, _adjusted(pair, max_disparity, what)
    result: StereoPair = context.adjusted[key][1]
    return result


def _adjusted(pair: StereoPair, max_disparity: int, what: Adjust) -> StereoPair:
    if "noise" in what:
        pair = denoised(pair)
    if "rows" not in what and "light" not in what:
        return pair
    reduced, factor = _reduced(pair, max_disparity)
    correction, disparity = _estimated(reduced, -(-max_disparity // factor), what)
    pair = correction.apply(pair, factor)
    if "light" in what and disparity is not None:
        right = correction.apply(reduced, 1).right
        pair = replace(pair, light_trust=light_trust(disparity, reduced.left, right, factor, pair.shape))
    return pair


class AdjustingMatcher(BaseModel):
    """The part of a matcher that first adjusts the right image to the left one."""

    adjust: Adjust = ()

    def prepared(
        self, pair: StereoPair, max_disparity: int, context: Context | None, clock: Clock
    ) -> tuple[StereoPair, Self]:
        """Return the pair adjusted, and the matcher without this step."""
        return adjusted(pair, max_disparity, self.adjust, context, clock), self.model_copy(update={"adjust": ()})


def _reduced(pair: StereoPair, max_disparity: int) -> tuple[StereoPair, int]:
    """Return the pair at the reduced size, in 8-bit color, and the factor by which its sides are smaller."""
    factor, n_pixels = 2, pair.shape[0] * pair.shape[1]
    while n_pixels > _MAX_PIXELS * factor**2 or n_pixels * max_disparity > _MAX_COSTS * factor**3:
        factor *= 2
    height, width = (-(-side // factor) for side in pair.shape)
    left, right = (
        cast(Image, cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)) for image in pair.clamped
    )
    return StereoPair(*StereoPair(left, right, pair.bits).color8), factor


def _estimated(reduced: StereoPair, max_disparity: int, what: Adjust) -> tuple[Correction, Floats | None]:
    """Return the correction of a reduced pair's right image, and the disparities used to estimate it."""
    correction = previous = IDENTITY
    disparity, max_matches = None, 0
    for _ in range(_MAX_PASSES):
        found = _matched(correction.apply(reduced, 1), max_disparity)
        n_matches = 0 if found is None else int(np.count_nonzero(~np.isnan(found)))
        if found is None or n_matches < _MIN_SHARE_OF_MATCHES * max_matches:
            return previous, disparity
        disparity, previous, max_matches = found, correction, max(max_matches, n_matches)
        if "light" in what:
            right = replace(correction, gains=IDENTITY.gains).apply(reduced, 1).right
            correction = replace(correction, gains=estimate_gains(disparity, reduced.left, right))
        if "rows" in what:
            right = replace(correction, row_shift=IDENTITY.row_shift).apply(reduced, 1).right
            row_shift = estimate_row_shift(disparity, reduced.left, right, correction.row_shift)
            correction = replace(correction, row_shift=row_shift)
        if np.abs(correction.row_shift - previous.row_shift).sum() <= _REMATCH_THRESHOLD:
            break
    return correction, disparity


def _matched(pair: StereoPair, max_disparity: int) -> Floats | None:
    """Return the disparities of a reduced pair, NaN without a match; None if there are too few."""
    if min(pair.shape) < BLOCK or max_disparity + 1 < _MIN_DISPARITIES:
        return None
    disparity = _STAGES.compute(pair, max_disparity, Clock()).disparity
    return disparity.values if np.count_nonzero(disparity.valid) >= _MIN_MATCHES else None
