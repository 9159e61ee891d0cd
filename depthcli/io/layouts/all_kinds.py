"""The layouts of every kind of scene."""

from __future__ import annotations

from depthcli.io.layouts.base import Layouts
from depthcli.io.layouts.depth import FRAMES
from depthcli.io.layouts.registration import VOLUMES
from depthcli.io.layouts.stereo import PAIRS
from depthcli.io.scenes import Scene

ALL_KINDS = Layouts.of(Scene, *PAIRS.rows, *FRAMES.rows, *VOLUMES.rows)
