"""Files: from a folder to scenes, from a scene to arrays, and from arrays to files. Only here are files opened.

``walk.discover_scenes(folder, PAIRS)`` tries the layouts of pairs on a folder and gives its scenes, which name files;
nothing is opened yet. ``load_...`` reads the input of a method from a scene, ``true_...`` what its result is compared
with, by ``formats``, where each reader gives an array or one :class:`~depthcli.core.errors.InputError` that names the
file.

=================  ============================================================================================
``walk``           start here: the scenes of a folder, by layouts; those that a pattern chooses
``named_files``    scenes given on the command line: files, two patterns or folders, videos, a table
``inputs``         archives and URLs, fetched and unpacked once
``layouts/``       how people lay out folders, tables of file names: which files a scene has
``scenes``         what kinds of scene there are, as files and facts
``stereo_pairs``   loads stereo pairs; ``rgbd_frames`` color and depth, ``volume_pairs`` registered volumes
``formats/``       content of files, one module per format: images, disparity, depth, volumes, fields, calibrations
``networks/``      trained networks that the package brings along
=================  ============================================================================================

Results: images (H, W) grey or (H, W, 3) RGB, uint8 or uint16; disparity (H, W) float32 in pixels; depth
(H, W) float32 in meters; volumes (Z, Y, X) float32 with a grid in mm along LPS (left, posterior, superior). NaN is
unknown.
"""
