"""Confidence of a medical registration, voxel by voxel (thesis chapter 7): from the registered pair alone."""
