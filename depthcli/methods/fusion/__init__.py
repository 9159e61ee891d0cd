"""Fusion: several similarity measures into one cost volume, weighted by confidence and consensus (chapter 6).

In: a ``StereoPair``, the largest disparity (pixels), and for measures made elsewhere their (H, W, D) costs. Out: a
``StereoResult``: left disparities (H, W) in pixels with status and confidences. :class:`.config.FuseConfig` is the root
of the command's config. Start reading at :meth:`.pipeline.Fusion.fuse`; what follows is in the order of use:

| module | what it does |
|---|---|
| ``measures`` | costs (H, W, D) of every measure |
| ``blend`` | brings them to one scale; later their weights (M, H, W), and the weighted mean |
| ``votes`` | a measure's disparity counts as far as the pixels around vote for it |
| ``support`` | which pixels may vote, weighted by distance and color, and sums over them |
| ``maps`` | optional: mixes the finished map with maps of other methods |
| ``map_costs`` | costs of a map at a pixel: matching, the other maps, the right view, the neighbors |
| ``choice`` | which map is taken at a pixel: by graph cuts (``energy``) or by a trained ``network`` |
"""

from __future__ import annotations

from depthcli.methods.fusion.pipeline import Fusion

__all__ = ["Fusion"]
