"""The functions of ``import depthcli``: arrays in, results out; ``save`` of a result writes files.

The commands call the same functions: a command reads the files of a scene, gets the result and saves it. The names that
users import are listed in ``depthcli/__init__.pyi``; all others may change.

| module | holds |
|---|---|
| ``stereo`` | ``stereo``, ``fuse`` and ``matcher``: a rectified pair -> ``Disparity`` |
| ``matching`` | the part of these that the commands that match pairs call, too |
| ``rigs`` | calibrations that rectify pairs, read and kept |
| ``depth`` | ``refine_depth``, ``complete_transparent``: color and a sensor's depth -> ``RefinedDepth`` |
| ``registration`` | ``registration_confidence``: two volumes on one grid -> ``RegistrationConfidence`` |
| ``maps`` | ``map_confidence``, ``fuse_maps``: maps of any program -> ``MapConfidence``, ``Disparity`` |
| ``scores`` | ``evaluate``: an estimate and the truth -> ``Scores`` |
| ``results`` | ``Disparity``, and the ``Depth`` and the ``PointCloud`` that it becomes |
| ``saving`` | the files that results write, and which pixels get a depth or become points |
| ``inputs`` | ``load_config``; arrays that users have -> images, maps and volumes as methods take them |
"""
