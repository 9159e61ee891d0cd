"""Cameras, pairs of cameras, and how disparity becomes depth.

| module | contents |
|---|---|
| ``camera`` | ``Camera``: projection of one camera with a lens; ``Intrinsics``: the same without distortion |
| ``rig`` | ``Rig``: two cameras at fixed places; ``RectifiedRig``: both turned so that rows correspond |
| ``triangulation`` | ``PairGeometry``, the numbers by which a rectified pair's disparity becomes depth, and back |
| ``color_and_depth`` | ``ColorAndDepth``: a depth camera's map in the pixels of the color camera next to it |
"""
