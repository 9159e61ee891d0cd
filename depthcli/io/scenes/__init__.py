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

from depthcli.io.scenes.kinds import LEFT_OUT as LEFT_OUT
from depthcli.io.scenes.kinds import MAX_DISPARITY as MAX_DISPARITY
from depthcli.io.scenes.kinds import DisparityScene as DisparityScene
from depthcli.io.scenes.kinds import GivenMap as GivenMap
from depthcli.io.scenes.kinds import MapsScene as MapsScene
from depthcli.io.scenes.kinds import RgbdScene as RgbdScene
from depthcli.io.scenes.kinds import RgbIrScene as RgbIrScene
from depthcli.io.scenes.kinds import Scene as Scene
from depthcli.io.scenes.kinds import SequenceScene as SequenceScene
from depthcli.io.scenes.kinds import StereoScene as StereoScene
from depthcli.io.scenes.kinds import VolumePairScene as VolumePairScene
from depthcli.io.scenes.kinds import check_same_size as check_same_size
from depthcli.io.scenes.kinds import sequences as sequences
from depthcli.io.scenes.rows import Folder as Folder
from depthcli.io.scenes.rows import Layout as Layout
from depthcli.io.scenes.rows import Layouts as Layouts
from depthcli.io.scenes.rows import plugins_of_scenes as plugins_of_scenes
