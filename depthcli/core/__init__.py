"""Common ground of all packages: from a config to an algorithm, inputs and outputs of algorithms, errors.

Read ``method`` first: an algorithm is one file with one pydantic model, and a folder of such files is a registry.

| module | contents |
|---|---|
| ``method`` | ``Method``, base of the algorithms; ``Family``, those of a folder |
| ``plugins`` | registries of named classes, and the classes, commands and presets of plug-ins |
| ``config_file`` | presets; ``load_config``: a YAML file, its base and ``--set`` become a checked model |
| ``yaml_source`` | the YAML below it: plain data, with the line of every value; ``to_yaml`` back |
| ``frames``, ``volumes`` | inputs: a rectified pair; color and depth; two volumes on one grid |
| ``color_and_infrared`` | input: color, infrared and depth |
| ``maps``, ``result`` | outputs: a map with the status of every pixel; named results of a method |
| ``context`` | passed along with a scene: memory, clock, results that scenes share |
| ``bound`` | requirements on a map's error bounds |
| ``cameras`` | one camera, two of them, their rectification; disparity and depth; the Kinect's raw codes |
| ``memory`` | large arrays that are recycled |
| ``errors``, ``text`` | errors that a user reads; foreign text made harmless; sizes in bytes |
"""
