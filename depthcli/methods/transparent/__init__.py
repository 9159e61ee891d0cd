"""Depth of transparent objects, from a sensor that sees through them and sparse depth from elsewhere (section 5.1).

``cross_modal`` makes the sparse depth by stereo of a color and an infrared camera, whose images and costs ``modality``
makes comparable; it may come from a file as well. ``fitted_frame`` cleans these samples, fits planes to them
everywhere (``fit``), and finds the regions where the sensor contradicts them (``unreliable``). A pipeline replaces the
sensor there: ``robust`` by the fit, ``crf``, the thesis's method, by a dense CRF over depth labels; ``nearest`` and
``joint_bilateral`` are for comparison. All work in inverse depth, in which planes are affine.
"""
