"""The functions of ``import depthcli``: arrays in, results out; ``save`` of a result writes files.

The commands call the same functions: a command reads the files of a scene, gets the result and saves it. The names that
users import are listed in ``depthcli/__init__.pyi``; all others may change.

| module | holds |
|---|---|
| ``stereo`` | ``stereo``, ``fuse`` and ``matcher``: a rectified pair -> ``Disparity`` |
| ``depth`` | ``refine_depth``, ``complete_transparent``: color and a sensor's depth -> ``RefinedDepth`` |
| ``registration`` | ``registration_confidence``: two volumes on one grid -> ``RegistrationConfidence`` |
| ``maps`` | ``map_confidence``, ``fuse_maps``: maps made before -> ``MapConfidence``, ``Disparity`` |
| ``judging`` | what these share with the commands on given maps |
| ``scores`` | ``evaluate``: an estimate and the truth -> ``Scores`` |
| ``results``, ``points`` | what the first two return, and point clouds made of it |
| ``config`` | presets, files and overrides -> config |
| ``matching`` | what ``stereo`` shares with the commands that match pairs |
| ``running`` | what every computation is wrapped in |
| ``arrays`` | the arrays that users have -> images and maps as methods take them |
"""

from depthcli import programs  # noqa: F401  adds pipelines to the families of methods
