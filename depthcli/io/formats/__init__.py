"""File formats, one module each: libraries decode, and their errors become one line. Results are checked.

================  ============================================================================================
``files``         start here: read regular files, write files atomically, name files in messages
``plain_text``    numbers, key-value lines, tables and JSON objects, as in calibrations
``images``        PNG, JPEG, Netpbm, TIFF, BMP: pixels, or codes of one channel; pairs
``exr``           channels of OpenEXR files
``disparity``     disparities in pixels, masks, status codes, and any map of one channel (``read_plane``)
``map_format``    formats of maps that plug-ins add
``depth``         depths in meters, sensor codes, point clouds
``calibrations``  cameras and pairs of cameras, rectified or not, in other programs' files
``poses``         camera poses
``videos``        frames of videos
``volumes``       volumes: ``read_volume``, ``write_volume``; files that a volume or a chain of transforms needs
``fields``        transforms, displacement fields and landmarks of registration programs
``networks``      weights of trained networks
================  ============================================================================================
"""
