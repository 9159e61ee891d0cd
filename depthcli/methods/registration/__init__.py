"""Confidence of a medical registration, voxel by voxel (thesis chapter 7): from the registered pair alone.

In this order: volumes on a grid of cubic voxels (:mod:`.pipeline`) -> channels of a :mod:`.feature` -> cost curves over
displacements and their measures (:mod:`.search`, kernels in ``_search``) -> expected error in mm (:mod:`.millimeters`).
"""
