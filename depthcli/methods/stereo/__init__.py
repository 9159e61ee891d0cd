"""Stereo: a disparity map from a rectified image pair (thesis, chapters 2 and 3).

Start at :func:`.matching.match`. The modules, in the order in which data pass them:

| module | input -> output |
|---|---|
| ``rectification`` | two views -> matched key points -> homographies that bring these to the same rows |
| ``keypoint_matching`` | pair -> matched key points, for the segments of chapter 2 |
| ``search_range`` | pair, ends given by the user or "auto" -> the disparities to search (by the pair at a small size) |
| ``matching`` | matcher, pair, largest disparity, limits -> ``StereoResult``; matched whole, in tiles or on a device |
| ``stages`` | ``PairMatcher``, the members of all matchers; ``CostStages``, the families below in one object |
| ``pipeline/`` | the matchers of ``stereo``, one file each: pair, largest disparity -> ``StereoResult`` |
| ``tiling/`` | a matcher and a pair too large to match whole -> ``StereoResult``, tile by tile, coarse to fine |
| ``volume`` | the types that stages pass to each other: ``CostVolume``, ``RefinementContext``, ``StereoResult`` |
| ``on_device`` | the same types in a device's memory; ``_device_table`` names each method's implementation there |

The families of methods, a folder each with one file per method; a folder's ``_device`` has OpenCL kernels:

| family | input -> output (H, W: rows and columns; D: disparities) |
|---|---|
| ``adjustment/`` | pair -> the pair with rows and light of its right image adjusted to the left one |
| ``cost/`` | pair, D -> (H, W, D) costs, ``costs[y, x, d]``: difference of left (y, x) and right (y, x - d) |
| ``aggregation/`` | costs, pair -> their means over a support window (``cross``: a window that follows colors) |
| ``optimization/`` | costs, pair -> costs that include smoothness; every pixel then takes its cheapest disparity |
| ``refinement/`` | map, costs, pair -> a better (H, W) map: outliers removed, holes filled, subpixel values |
| ``networks`` | network file, images -> disparities or features, for the pipeline and the cost called ``onnx`` |
| ``boundary/`` | colors of two segments -> cost of different planes at their boundary |
| ``segments/`` | costs, pair -> map with one plane per segment, instead of optimization and selection |
"""
