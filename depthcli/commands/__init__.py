"""The sub-commands, one file each; the only place where files meet algorithms.

A public module here is a command: its name is the module's, its help the first paragraph of the module's docstring,
and ``COMMAND`` the object that does it, a :class:`depthcli.run.command.Command`, whose ``run(values, reporter)`` gets
the values of all options and returns the exit code. Nothing heavy is imported before a command runs.

Commands that make a run folder of scenes are a ``BatchCommand`` (of module ``_batch``, imported from here). Their
``run`` checks the options, makes the config (``_options``, presets, ``--set``), finds the scenes (``_scenes``) and
hands both to ``run_on``, which has ``depthcli.run.runner`` call ``compute(config, scene, folder, memory)`` for each
scene, writes the legend, runs ``--evaluate`` and prints the table. A ``ConfigCommand`` is one with a CONFIG argument.
What ``compute`` does:

========================  ============================================================================================
``stereo``, ``fuse``      ``_pairs``: load the pair, or rectify it (``_rectified``); find the search range; match by
                          the config's pipeline or fusion; write map, status and preview (``api``)
``refine-kinect``         load depth and color of a frame, or of a sequence in order; refine; write (``api``)
``transparent``           load depth, color and sparse depth, or match infrared for it; complete; write (``api``)
``register-confidence``   load two volumes and the registration; search around every voxel; write confidence, expected
                          error and shift as volumes (``api``)
``confidence``            read maps that were made before; judge them by the images; write confidence, status, map
``fuse maps``             read maps that were made before; take the likeliest at every pixel; write map, status
``depth``                 read a run's disparity map and its calibration; triangulate; write depth, and points
``rectify``               load the views; match key points; warp by the calibration or the points; write both views,
                          calib.txt and the search range
``sample``                draw a scene of known truth; write images, truth and masks
========================  ============================================================================================

The others:

============  ======================================================================================================
``evaluate``  finds runs and truth; scores scene by scene by the protocol of each (``_scoring``); writes scores, error
              pictures, curves and the page
``sweep``     makes a config of every combination; runs each as its command does; evaluates all; writes the tables
``export``    finds the maps of a benchmark's scenes; checks all; writes the archive as its server takes it
``calibrate`` finds a board's corners in photos; solves for lenses and places without outliers; writes rig and report
``merge``     joins the reports of the processes that shared a run
``help``      explains columns, layouts, files and other topics, from the code
``presets``   lists the configs that are shipped, or prints one with its fields
``devices``   lists what stereo can run on, and measures the bandwidth
``warmup``    compiles the kernels that presets call, or lists them
============  ======================================================================================================
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli import programs  # noqa: F401  adds pipelines to the families of methods
from depthcli.core.registry import Registry, plugin_of

if TYPE_CHECKING:
    from depthcli.commands._batch import BatchCommand, ConfigCommand
    from depthcli.run.command import Command

__all__ = [
    "REGISTRY", "BatchCommand", "ConfigCommand", "command_names", "find_command", "grouped_commands", "help_of",
    "load_command",
]  # fmt: skip


def __getattr__(name: str) -> object:
    """Return a base class of commands; ``--help`` does without their imports."""
    if name not in ("BatchCommand", "ConfigCommand"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    base: object = getattr(importlib.import_module(f"{__name__}._batch"), name)
    return base


_GROUPS = {
    "Match and refine": (
        "stereo",
        "fuse",
        "refine-kinect",
        "transparent",
        "confidence",
        "fuse-maps",
        "register-confidence",
    ),
    "Prepare and convert": ("sample", "calibrate", "rectify", "depth"),
    "Evaluate and report": ("evaluate", "sweep", "export", "merge"),
    "Inspect and set up": ("help", "presets", "devices", "warmup"),
}
"""Headings of ``depthcli --help``; commands that are listed nowhere come last, under a heading of their own."""


def _command_of(value: object) -> Command:
    from depthcli.run.command import Command

    command = value() if isinstance(value, type) else value
    if not isinstance(command, Command):
        raise TypeError(f"want a class derived from depthcli.run.command.Command, got {value!r}")
    return command


REGISTRY: Registry[Command] = Registry(
    __name__, lambda module: _command_of(module.COMMAND), _command_of, ("depthcli.run.command",)
)
"""Our own commands, and those of plug-ins."""


def command_names() -> list[str]:
    """Return the names of our own commands, as typed, sorted."""
    return [name.replace("_", "-") for name in REGISTRY.own_names]


def grouped_commands() -> dict[str, list[str]]:
    """Return heading -> names of its commands, in the order of ``depthcli --help``; every command is under one."""
    names = [name.replace("_", "-") for name in REGISTRY.names()]
    groups = {heading: [name for name in group if name in names] for heading, group in _GROUPS.items()}
    if more := [name for name in names if not any(name in group for group in groups.values())]:
        groups["More"] = more
    return groups


def load_command(name: str) -> Command:
    """Return the command of that name, ours or a plug-in's; KeyError where there is none."""
    command = find_command(name)
    if command is None:
        raise KeyError(name)
    return command


def find_command(name: str) -> Command | None:
    """Return the command of that name, ours or a plug-in's; None where there is none."""
    known = REGISTRY.find(name)
    return None if known is None else REGISTRY.load(known)


def help_of(name: str) -> str:
    """Return the first paragraph of its module's docstring, without importing it: ``--help`` shows all commands.

    For a command of a plug-in it is that of its class, with the package and its version.
    """
    if name not in command_names():
        kind = type(load_command(name))
        text, plugin = inspect.getdoc(kind) or "", plugin_of(kind)
        package = "" if plugin is None else f" ({plugin.package} {plugin.version})"
        return " ".join(text.split("\n\n")[0].split()) + package
    spec = importlib.util.find_spec(f"{__name__}.{name.replace('-', '_')}")
    source = "" if spec is None or spec.origin is None else Path(spec.origin).read_text("utf-8")
    doc = source.split('"""')[1] if source.startswith('"""') else ""
    return " ".join(doc.strip().split("\n\n")[0].split())
