"""Stereo: a rectified image pair in, a disparity map out (thesis, chapters 2 and 3).

Start at :func:`.matching.match`. In the order of the data:

| module | what comes in -> what goes out |
|---|---|
| ``config`` | the fields of the ``stereo`` command's config, and of every command that matches pairs |
| ``rectification`` | points matched by ``view_matching`` -> homographies that bring them to the same rows |
| ``search_range`` | pair, ends given by the user or "auto" -> the disparities to search (by the pair at a small size) |
| ``matching`` | matcher, pair, largest disparity, limits -> ``StereoResult``; matched whole, in tiles or on a device |
| ``stages`` | ``PairMatcher``, the base of all matchers; ``CostStages``, the families below in one object |
| ``pipeline/`` | the matchers of ``stereo``, one file each: pair, largest disparity -> ``StereoResult`` |
| ``tiling/`` | a matcher and a pair too large to be matched whole -> ``StereoResult``, tile by tile, coarse to fine |
| ``volume`` | the types that stages hand to each other: ``CostVolume``, ``RefinementContext``, ``StereoResult`` |
| ``on_device`` | the same types in the memory of a device; ``_device_table`` says what runs a method there |

What a pipeline is made of; a family is a folder with one file per method, and its ``_device`` holds OpenCL kernels:

| family | what comes in -> what goes out (H, W: rows and columns; D: disparities) |
|---|---|
| ``adjustment/`` | pair -> the pair with rows and light of its right image adjusted to the left one |
| ``cost/`` | pair, D -> (H, W, D) costs, ``costs[y, x, d]``: how left (y, x) and right (y, x - d) differ |
| ``aggregation/`` | costs, pair -> their means over a support window (``cross``: one that follows colors) |
| ``optimization/`` | costs, pair -> costs that include smoothness; every pixel then takes its cheapest disparity |
| ``refinement/`` | map, costs, pair -> a better (H, W) map: outliers removed, holes filled, subpixel values |
| ``networks`` | file of a network, images -> disparities or features, for the pipeline and the cost called ``onnx`` |
| ``segments/`` | costs, pair -> map with one plane per segment, instead of optimization and selection |
"""
