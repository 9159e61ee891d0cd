"""Solvers and building blocks that several methods share; their inputs and outputs are arrays.

Images are (H, W, 3) uint8 RGB, maps (H, W) float32 with NaN where nothing is known, labels int32 that count from 0.

| module | computes |
|---|---|
| ``graph_cut`` | labels of least energy: exactly for two labels; approximately for more |
| ``trws`` | one of several candidate values per pixel, with small energy, by tree-reweighted message passing (TRW-S) |
| ``dense_crf`` | marginals of labels where all pairs of points influence each other (a conditional random field) |
| ``segmentation`` | partitions of an image into regions, one file per method |
| ``regions`` | of label maps: connected components, their pixels, the graph of neighbors, merging |
| ``keypoints`` | distinctive points with descriptors, one file per method |
| ``plane_fitting`` | planes and polynomials through known values, robust to outliers |
| ``filters`` | local mean and variance, masks of discontinuities, gaps filled by similar color, OpenCV in one thread |
| ``body`` | the body in a slice of a medical volume, apart from the air around it |
| ``resampling`` | samples of volumes: trilinear, nearest, block means, shifts |
"""
