"""Confidence of a medical registration, voxel by voxel, from the registered pair alone (thesis, chapter 7).

In: a ``RegisteredPair``, two volumes (Z, Y, X) float32 on one grid, spacing in mm, and a mask. Out: a
``RegistrationResult`` on the grid of measured voxels: expected error, mm; certainty, 0 to 1; shift to the match, mm.
Start at ``pipeline.search``: if a search finds a better match than the registration's, the registration is incorrect.

| module | step |
|---|---|
| ``pipeline`` | the data flow; one file per pipeline. ``search``: both volumes on a working grid of cubic voxels, and \
the expected error, mm, from one of the measures |
| ``feature`` | uint8 channels for the comparison; one file per feature |
| ``search`` (kernels in ``_search_kernels``) | costs of all displacements of a voxel, and measures of their curve |
"""
