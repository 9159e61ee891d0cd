"""Depth of transparent objects, from a sensor that sees through them and sparse depth from elsewhere (section 5.1).

In: a ``SparseFrame`` (color, the sensor's depth, sparse depth; (H, W), meters), or an ``RgbIrFrame`` (color, infrared,
the sensor's depth), of which ``cross_modal`` makes one. Out: a ``RefinedDepth``: (H, W) meters, with a status and a
standard deviation. ``config`` is the root of the command's config; start reading at ``pipeline/robust``. In the order
in which they are used:

| module | decision |
|---|---|
| ``modality`` | how color and infrared images become comparable: weights of the color channels, faded costs |
| ``cross_modal`` | which matches of stereo between these images become sparse depth |
| ``fitted_frame`` | which sparse samples are outliers; planes through the others at every pixel |
| ``unreliable`` | in which regions the sensor contradicts the planes |
| ``pipeline`` | what replaces the sensor there: ``robust`` the planes, far from samples smoothed (``smoothing``); \
``crf``, of the thesis, a dense CRF over depth labels; ``nearest`` and ``joint_bilateral`` are for comparison |

All but ``cross_modal``, which works in pixels of disparity, compute with inverse depth, in which planes are affine.
"""
