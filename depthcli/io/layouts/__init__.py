"""Layouts of data sets in folders: rows of tables, the few special readers beside them, and plug-ins.

================  ===========================================================================================
``base``          a folder as a layout sees it, and the class of layouts
``rows``          a row of a table: file names with placeholders; rows of a user's YAML file
``stereo``        the table of stereo pairs
``depth``         the table of frames of color and depth
``registration``  pairs of volumes
================  ===========================================================================================
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

from depthcli.core.registry import Plugin
from depthcli.io.layouts.base import PLUGINS, Folder, Layout
from depthcli.io.layouts.depth import DEPTH_LAYOUTS
from depthcli.io.layouts.registration import Registration
from depthcli.io.layouts.stereo import STEREO_LAYOUTS
from depthcli.io.scenes import Scene

__all__ = ["Folder", "Layout", "layout_plugins", "layouts", "own_layouts"]


@cache
def own_layouts() -> tuple[Layout, ...]:
    """Return the layouts of this package, sorted by name."""
    return tuple(sorted((*STEREO_LAYOUTS, *DEPTH_LAYOUTS, Registration()), key=lambda layout: layout.name))


def layouts() -> tuple[Layout, ...]:
    """Return every layout: those of this package, then those of plug-ins."""
    return (*own_layouts(), *(PLUGINS.load(name)() for name in PLUGINS.names()))


def layout_plugins(scenes: Iterable[Scene]) -> set[Plugin]:
    """Return the plug-ins whose layouts found any of these scenes."""
    plugins = PLUGINS.plugins()
    names = {scene.layout for scene in scenes} if plugins else set()
    return {plugin for name, plugin in plugins.items() if name.replace("_", "-") in names}
