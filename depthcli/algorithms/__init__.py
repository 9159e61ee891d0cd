"""Solvers and building blocks that several methods share; their inputs and outputs are arrays.

Images are (H, W, 3) uint8 RGB; maps are (H, W) float32, NaN = unknown; labels are int32 and count from 0.

| module | result |
|---|---|
| ``graph_cut`` | labels of minimum energy: exact for two labels, approximate for more |
| ``trws`` | one of several candidate values per pixel, with small energy, by tree-reweighted message passing (TRW-S) |
| ``dense_crf`` | marginals of labels in a fully connected conditional random field |
| ``segmentation`` | partitions of an image into regions, one file per method |
| ``regions`` | connected components of label maps, their pixels, the graph of neighbors, merging |
| ``nearest`` | the points nearest to given places |
| ``keypoints`` | distinctive points with descriptors, one file per method |
| ``plane_fitting`` | planes and polynomials through known values, robust to outliers |
| ``filters`` | local mean and variance, discontinuity masks, gaps filled by similar color, OpenCV in one thread |
| ``calibration`` | cameras and rigs from photos of a board |
| ``pixel_network``, ``error_table`` | log odds from a small network; error bounds and probabilities from log odds |
| ``body`` | mask of the body in a medical volume |
| ``resampling`` | samples of volumes: trilinear, nearest, block means, shifts |
"""
