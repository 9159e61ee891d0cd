"""Robust fits of planes, and of polynomials of low degree, to the known values of a map.

| module | one surface for | robust by | result |
|---|---|---|---|
| ``window_planes`` | every pixel, through its window | Tukey's biweight, three reweightings | ``WindowPlanes`` |
| ``window_slopes`` | every pixel, through pixels of similar color | weights ``1 - r^2``, shrinkage | slopes only |
| ``sample_planes`` | any pixel, through the nearest samples | Tukey's biweight, narrowing gate | ``SamplePlanes`` |
| ``segment_planes`` | every segment | RANSAC, least squares over the inliers | ``SegmentPlanes`` |
| ``polynomials`` | every segment, up to degree 2 | Huber's weights, until convergence | ``Surfaces`` |

``least_squares`` has the weights, moments and solvers that these and other kernels share.
"""
