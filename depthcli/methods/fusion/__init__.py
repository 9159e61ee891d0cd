"""Fusion: several measures in one cost volume, weighted by confidence and consensus (thesis, chapter 6).

Input: a ``StereoPair``, the largest disparity (pixels), and, for measures made elsewhere, their (H, W, D) costs.
Output: a ``StereoResult``: left disparities (H, W) in pixels with status and confidences. Start reading at
:meth:`.pipeline.Fusion.fuse`, which numbers the steps.

A *voter* is the disparity map of one measure. At every pixel its disparity is a *vote*, weighted by its confidence. The
*support* of a pixel is the pixels around it that vote for it. The *share* of a disparity at a pixel, 0 .. 1, is the sum
of the votes for it in the support, weighted by distance and color, over the largest possible sum. A *ballot*
(``Ballot``) contains the votes of all voters at all pixels. In the order of first use:

| module | purpose |
|---|---|
| ``pipeline`` | costs (H, W, D) of every measure, and the order of the steps |
| ``blend`` | brings them to one scale; later the measures' weights (M, H, W), and the weighted mean of the costs |
| ``votes`` | the supports; the ballot: shares of disparities, and costs of disparities with a small share |
| ``maps`` | optional: mixes the finished map with maps of other methods |
| ``choice`` | which map is taken at a pixel: by graph cuts (``energy``) or by a trained ``network`` |
| ``map_costs`` | costs of a map at a pixel: matching, the other maps, the right view, the neighbors |
"""
