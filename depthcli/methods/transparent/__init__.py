"""Depth of transparent objects, which the sensor sees through, by sparse depth from elsewhere (thesis, section 5.1).

In: a ``SparseFrame`` (color, the sensor's depth, sparse depth; (H, W), meters), or an ``RgbIrFrame`` (color, infrared,
the sensor's depth), of which ``cross_modal`` makes one. Out: a ``DepthResult``: (H, W) meters, with a status.
``config`` is the root of the command's config; start reading at ``pipeline/robust``. In the order of use:

| module | decision |
|---|---|
| ``cross_modal``, ``color_mix`` | how color and infrared images become comparable |
| ``match_selection`` | which of their matches become sparse depth |
| ``fitted_frame`` | which sparse samples are outliers; planes through the others at every pixel |
| ``unreliable`` | in which regions the sensor contradicts the planes |
| ``bounds`` | how wrong each value of the result may be |

| pipeline | what replaces the sensor where it is unreliable or unknown |
|---|---|
| ``robust`` | 1. ``fitted_frame`` and ``unreliable``: planes, and where they replace the sensor. \
2. Smoothing of the planes far from samples |
| ``crf``, of the thesis | 1. As ``robust``; may be left out. 2. A dense CRF, labels are steps of inverse depth |
| ``sensor``, from a mask of the objects | values around continue, as ``kinect.gap_filling`` has it |
| ``nearest``, for comparison | the depth of the nearest sample |
| ``joint_bilateral``, for comparison | means of reliable values around, weighted by distance and color |

All but ``cross_modal``, which works in pixels of disparity, compute with inverse depth, in which planes are affine.
"""
