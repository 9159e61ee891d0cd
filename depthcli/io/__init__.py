"""Files: find scenes in folders, load their arrays, and write arrays. Only this package opens files.

``scenes.find.discover_scenes(folder, PAIRS)`` tries the layouts of stereo pairs on a folder and returns its scenes as
names of files, without opening them. ``load_...`` reads the input of a method from a scene, and ``true_...`` its
ground truth. Both use ``formats``, whose readers return an array or raise one
:class:`~depthcli.core.errors.InputError` that names the file.

=================  ============================================================================================
``scenes/``        start here: ``find`` returns the scenes of a folder, an archive, a URL or command-line options;
                   ``pairs``, ``frames`` and ``volumes`` describe folder layouts by rows of file names
``stereo_pairs``   loads stereo pairs; ``rgbd_frames`` color and depth, ``volume_pairs`` registered volumes,
                   ``calibration_photos`` photos of a board
``formats/``       file contents, one module per format: images, disparity, depth, volumes, fields, calibrations
``networks/``      trained networks of the package
=================  ============================================================================================

Arrays: images are (H, W) grey or (H, W, 3) RGB, uint8 or uint16; disparity is (H, W) float32 in pixels; depth is
(H, W) float32 in meters; volumes are (Z, Y, X) float32 with a grid in mm along LPS (left, posterior, superior). NaN
is unknown.
"""
