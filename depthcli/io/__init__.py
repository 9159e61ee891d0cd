"""Files: from a folder to scenes, from a scene to arrays, and from arrays to files. Only here are files opened.

``scenes.find.discover_scenes(folder, PAIRS)`` tries the layouts of pairs on a folder and gives its scenes, which name
files; nothing is opened yet. ``load_...`` reads the input of a method from a scene, ``true_...`` what its result is
compared with, by ``formats``, where each reader gives an array or one :class:`~depthcli.core.errors.InputError` that
names the file.

=================  ============================================================================================
``scenes/``        start here: ``find`` gives the scenes of a folder, an archive, a URL, or of options; ``pairs``,
                   ``frames`` and ``volumes`` tell how people lay out folders, by rows of file names
``stereo_pairs``   loads stereo pairs; ``rgbd_frames`` color and depth, ``volume_pairs`` registered volumes,
                   ``calibration_photos`` photos of a board
``formats/``       content of files, one module per format: images, disparity, depth, volumes, fields, calibrations
``networks/``      trained networks that the package brings along
=================  ============================================================================================

Results: images (H, W) grey or (H, W, 3) RGB, uint8 or uint16; disparity (H, W) float32 in pixels; depth
(H, W) float32 in meters; volumes (Z, Y, X) float32 with a grid in mm along LPS (left, posterior, superior). NaN is
unknown.
"""
