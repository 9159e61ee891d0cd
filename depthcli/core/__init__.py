"""What all other packages build on: how a config becomes an algorithm, what algorithms take and return, errors.

Read ``method`` first: an algorithm is one file with one pydantic model, and a folder of such files is a registry.

| module | contents |
|---|---|
| ``method`` | ``Method``, base of the algorithms; ``Family``, those of a folder |
| ``registry`` | named classes of one kind |
| ``plugins`` | what files of users and installed modules add to them |
| ``config_file`` | ``load_config``: a YAML file, the one it is based on, and ``--set`` become a checked model |
| ``yaml_source`` | the YAML below it: plain data, with the line of every value; ``to_yaml`` back |
| ``frames``, ``volumes`` | inputs: a rectified pair; color and depth; two volumes on one grid |
| ``color_and_infrared`` | input: color, infrared and depth |
| ``maps``, ``result`` | outputs: a map with the status of every pixel; what else a method returns, and its times |
| ``scene`` | the scene that is computed, as programs need to know it |
| ``cameras`` | one camera, two of them, their rectification; disparity and depth; the Kinect's raw codes |
| ``memory`` | large arrays that are recycled |
| ``errors``, ``text`` | errors that a user reads; foreign text made harmless; sizes in bytes |
"""
