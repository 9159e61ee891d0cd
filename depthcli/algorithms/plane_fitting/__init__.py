"""Robust fits of planes, and of polynomials of low degree, to the known values of a map.

| module | one surface for | robust by | gives |
|---|---|---|---|
| ``window_planes`` | every pixel, through its window | Tukey's biweight, three reweightings | ``WindowPlanes`` |
| ``window_slopes`` | every pixel, through pixels of similar color | weights ``1 - r^2``, shrinkage | slopes alone |
| ``sample_planes`` | any pixel, through the nearest samples | Tukey's biweight, narrowing gate | ``SamplePlanes`` |
| ``segment_planes`` | every segment | RANSAC, least squares over the inliers | ``SegmentPlanes`` |
| ``polynomials`` | every segment, up to degree 2 | Huber's weights, until the surface no longer moves | ``Surfaces`` |

``least_squares`` has the weights, moments and solvers that they and other kernels share; ``samples`` finds the
scattered samples nearest to a pixel.
"""
