"""Layouts of data sets in folders: rows of tables, the few special readers, and plug-ins.

================  ===========================================================================================
``base``          a folder as a layout sees it, the class of layouts, and the layouts of one kind of scene
``rows``          a row of a table: file names with placeholders; rows of a user's YAML file
``stereo``        ``PAIRS``, the table of stereo pairs
``depth``         ``FRAMES``, the table of frames of color and depth
``registration``  ``VOLUMES``, pairs of volumes
``all_kinds``     ``ALL_KINDS``, all of these
================  ===========================================================================================

A command imports the table of the scenes that it works on.
"""

from depthcli.io.layouts.base import Folder, Layout, Layouts, layout_plugins

__all__ = ["Folder", "Layout", "Layouts", "layout_plugins"]
