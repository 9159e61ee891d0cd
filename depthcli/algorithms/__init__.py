"""Solvers and building blocks that several methods share: labelling problems, segmentation, key points, filters."""
