"""Fusion: several similarity measures into one cost volume, weighted by confidence and consensus (chapter 6).

In this order, a file each: :mod:`.measures` (costs of every measure) -> :mod:`.blend` (their common scale) ->
:mod:`.votes` over :mod:`.support` (whose disparities the pixels around confirm) -> :mod:`.measures` (weights) ->
:mod:`.blend` (weighted mean) -> stages of stereo -> :mod:`.maps` (optional: other maps beside the fused one, from
which :mod:`.choice` takes the best at every pixel, by the costs and misfits of :mod:`.surfaces`).
:mod:`.pipeline` runs them, :mod:`.config` is the root of the command's config.
"""

from __future__ import annotations

from depthcli.methods.fusion.measures import Measure
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.fusion.votes import Consensus

__all__ = ["Consensus", "Fusion", "Measure"]
