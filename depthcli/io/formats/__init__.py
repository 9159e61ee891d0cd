"""Files, one module a format. A reader checks what a header announces before a library decodes what follows it.

===================  =========================================================================================
``files``            start here: regular files only, written wholly or not at all, named in every message
``headers``          kind and size of an image, by its first bytes; chunks of PNG
``images``           PNG, JPEG, Netpbm, TIFF, BMP: pixels, or codes of one channel
``pictures``         pictures for people: status bits, confidence, maps in color
``disparity``        disparities in pixels, and any map of one channel (``read_plane``): PFM, npy, PNG, TIFF
``map_format``       formats of maps that plug-ins add
``depth``            depths in meters, codes of sensors, point clouds
``kinect``           raw codes of a Kinect v1 and its calibration
``npy``              NumPy arrays
``stereo_images``    the two images of a pair, of one size and range
``videos``           frames of videos
``plain_text``       numbers, key-value lines and JSON objects, as calibrations hold them
``rigs``             two cameras that are not rectified: OpenCV, ROS, Kalibr, KITTI; color with infrared
``pair_geometry``    a rectified pair: Middlebury's calib.txt, KITTI's projections
``volumes``          volumes of any kind: ``read_volume``, ``write_volume``
``nifti``            headers of NIfTI; ``volume_headers`` those of MetaImage and NRRD
``fields``           what maps fixed points to moving ones: displacement fields, alone or after a transform
``transforms``       transforms of ITK and elastix
``landmarks``        lists of points
``networks``         weights of trained networks
===================  =========================================================================================
"""
