"""Scenes, and how to find them by rows of file names.

==========  =================================================================================================
``kinds``   the kinds of scene: file names and metadata
``places``  archives and URLs, fetched and unpacked once
``rows``    folders as layouts see them; rows of file names, from the package or a user's YAML file
``pairs``   ``PAIRS``, the table of stereo layouts; pairs from single files, patterns, videos and tables of files
``frames``  ``FRAMES``, the table of RGB-D layouts; single frames
``volumes`` ``VOLUMES``, the layout of volume pairs; single pairs
``find``    start here: find the scenes in a folder, or from a command's options
==========  =================================================================================================

A command imports the table for its kind of scene.
"""

from depthcli.io.scenes.kinds import (
    LEFT_OUT,
    MAX_DISPARITY,
    DisparityScene,
    GivenMap,
    MapsScene,
    RgbdScene,
    RgbIrScene,
    Scene,
    SequenceScene,
    StereoScene,
    VolumePairScene,
    check_same_size,
    sequences,
)
from depthcli.io.scenes.rows import Folder, Layout, Layouts, layout_plugins

__all__ = [
    "LEFT_OUT",
    "MAX_DISPARITY",
    "DisparityScene",
    "Folder",
    "GivenMap",
    "Layout",
    "Layouts",
    "MapsScene",
    "RgbIrScene",
    "RgbdScene",
    "Scene",
    "SequenceScene",
    "StereoScene",
    "VolumePairScene",
    "check_same_size",
    "layout_plugins",
    "sequences",
]
