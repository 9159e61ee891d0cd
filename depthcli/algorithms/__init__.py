"""Solvers and building blocks that several methods share; arrays in, arrays out.

| module | computes |
|---|---|
| ``graph_cut``, ``alpha_expansion`` | labels of least energy: two labels exactly; many, on any graph |
| ``trws`` | values of pixels of least energy, each from candidates of its own |
| ``dense_crf`` | marginals of labels where all pairs of points influence each other |
| ``segmentation``, ``regions`` | partitions of an image; graphs of their regions, merging |
| ``keypoints`` | distinctive points with descriptors |
| ``plane_fitting`` | planes and polynomials through known values, robust to outliers |
| ``filters``, ``joint_bilateral``, ``resampling`` | local filters, filling of gaps, values of volumes between voxels |
"""
