"""Depth of transparent objects, which the sensor sees through, from a second, sparse source (thesis, section 5.1).

In: a ``SparseFrame`` (color, the sensor's depth, sparse depth; (H, W), meters), or an ``RgbIrFrame`` (color, infrared,
the sensor's depth), which ``cross_modal`` converts to a ``SparseFrame``. Out: a ``DepthResult``: (H, W) meters, with a
status. Start reading at ``pipeline/robust``. In the order of use:

| module | decision |
|---|---|
| ``cross_modal`` | how color and infrared images become comparable |
| ``match_selection`` | which of their matches become sparse depth |
| ``fitted_frame`` | which sparse samples are outliers; planes through the others at every pixel |
| ``unreliable`` | in which regions the sensor contradicts the planes |
| ``bounds`` | the error bound of each value of the result |

| pipeline | replacement for the sensor where it is unreliable or unknown |
|---|---|
| ``robust`` | 1. ``fitted_frame`` and ``unreliable``: planes, and where they replace the sensor. \
2. Smoothing of the planes far from samples |
| ``crf``, of the thesis | 1. Like ``robust``; optional. 2. A dense CRF whose labels are steps of inverse depth |
| ``sensor``, from a mask of the objects | the values around, continued by ``kinect.gap_filling`` |
| ``nearest``, for comparison | the depth of the nearest sample |
| ``joint_bilateral``, for comparison | means of reliable values around, weighted by distance and color |

``cross_modal`` computes with disparity in pixels, all others with inverse depth, in which planes are affine.
"""
