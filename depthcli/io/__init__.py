"""Files: from a folder to scenes, from a scene to arrays, and from arrays to files. Only here are files opened.

``walk.discover_scenes(folder)`` tries every layout on a folder and gives its scenes; no image is opened yet.
``scene.load()`` gives the input of a method, ``scene.truth()`` what its result is compared with. Both read by
``formats``, where each reader gives an array or one :class:`~depthcli.core.errors.InputError` that names the file.

===============  ==============================================================================================
``walk``         start here: the scenes of a folder, by layouts; those that a pattern chooses
``pairs``        pairs of images given on the command line: two patterns, two folders, or a table
``layouts/``     how people lay out folders, one module per layout: which files a scene has
``scenes/``      what a scene holds and loads, one module per kind: stereo pairs, RGB-D frames, pairs of volumes
``formats/``     what is in a file, one module per format: images, disparity, depth, volumes, fields, calibrations
``generated/``   scenes with exact truth: ``arrays/`` computes them, ``samples/`` writes them (``depthcli sample``)
``networks/``    trained networks that the package brings along
===============  ==============================================================================================

What comes out: images (H, W) grey or (H, W, 3) RGB, uint8 or uint16; disparity (H, W) float32 in pixels; depth
(H, W) float32 in meters; volumes (Z, Y, X) float32 with a grid in mm along LPS (left, posterior, superior). NaN is
unknown.
"""
