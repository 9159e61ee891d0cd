"""Robust fits of planes, and of polynomials of low degree, to the known values of a map.

| module | one surface for | robust by |
|---|---|---|
| ``window_planes`` | every pixel, through the window around it | Tukey's biweight, three reweightings |
| ``window_slopes`` | every pixel, through pixels of similar color; slopes alone | weights ``1 - r^2``, shrinkage |
| ``sample_planes`` | any pixel, through the nearest scattered samples | Tukey's biweight from a wide to a narrow gate |
| ``segment_planes`` | every segment | RANSAC, least squares over the inliers |
| ``polynomials`` | every segment, up to degree 2 | Huber's weights until it settles |

What they share - weights, moments, solvers - is in ``least_squares``, for other kernels as well; ``samples`` finds the
samples that are nearest to a pixel.
"""
