"""Scenes, and one way to find them: by rows of file names.

==========  =================================================================================================
``kinds``   the kinds of scene, as files and facts
``places``  archives and URLs, fetched and unpacked once
``rows``    a folder as a layout sees it; a row of file names, of the package or of a user's YAML file
``pairs``   ``PAIRS``, the table of stereo pairs; pairs of single files, patterns, videos and tables of files
``frames``  ``FRAMES``, the table of frames of color and depth; single frames
``volumes`` ``VOLUMES``, pairs of volumes; single pairs
``find``    start here: the scenes of a folder, or of the options of a command
==========  =================================================================================================

A command imports the table of the scenes that it works on.
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
