"""Files, one module a format: libraries decode, their errors become one line, and their results are checked.

================  ============================================================================================
``files``         start here: regular files only, written wholly or not at all, named in every message
``plain_text``    numbers, key-value lines and JSON objects, as in calibrations
``images``        PNG, JPEG, Netpbm, TIFF, BMP: pixels, or codes of one channel; pairs
``exr``           channels of OpenEXR files
``masks``         masks of any values: above half of the largest is inside
``status``        status codes as a PNG, and the text that explains them
``disparity``     disparities in pixels, and any map of one channel (``read_plane``): PFM, npy, PNG, TIFF
``files_behind``  files that are read with another one: values of a volume, chains of transforms
``map_format``    formats of maps that plug-ins add
``depth``         depths in meters, codes of sensors, point clouds
``calibrations``  cameras and pairs of cameras, rectified or not, in the files of other programs
``poses``         where a camera was
``videos``        frames of videos
``volumes``       volumes of any kind: ``read_volume``, ``write_volume``
``fields``        transforms, displacement fields and landmarks of registration programs
``networks``      weights of trained networks
================  ============================================================================================
"""
