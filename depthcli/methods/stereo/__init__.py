"""Stereo: a rectified image pair in, a disparity map out (thesis chapters 2 and 3).

In the order of the data: ``search_range`` finds the disparities to search; ``matching`` decides whether the pair is
matched whole, in tiles or on a device, and calls a ``matcher``, such as a pipeline of ``pipeline/``. A pipeline adjusts
the right image (``adjustment/``), then computes costs (``cost/``, ``aggregation/``, ``optimization/``), selects
disparities and refines them (``refinement/``; ``stages`` has the order), or fits planes to ``segments/``. ``volume``
has the types that stages hand to each other, ``on_device`` those on a device. ``coarse_to_fine``, ``tiling`` and
``tiles`` match large pairs.
"""
