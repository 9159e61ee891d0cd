"""Messages and the options that they name."""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Iterator
from pathlib import Path

import grimp

import depthcli
from depthcli.cli import _COMMON
from depthcli.commands import command_names, load_command

ROOT = Path(depthcli.__file__).parent
# These import all others, to list what they have, or to find the columns of a table.
COMMANDS = [name for name in command_names() if name not in ("presets", "help", "merge")]
# An option of a command that is named before it (`evaluate --resize`) belongs to that command.
OPTION = re.compile(rf"(?:(?<![\w-])({'|'.join(command_names())}) )?(?<![\w-])(--[a-z][a-z-]*[a-z])")
BATCH = {
    name for name in COMMANDS if {"--jobs", "--overwrite"} <= {option.flag for option in load_command(name).options}
}
PAIRS = {"stereo", "fuse", "rectify", "depth"}
GIVEN = {"confidence", "fuse-maps"}
SCENES = PAIRS | GIVEN | {"refine-kinect", "transparent", "register-confidence"}
# Modules that more commands import than call for messages with options, or that are found by their files: who calls.
CALLERS = {
    "depthcli.api.matching": {"stereo", "fuse"},
    "depthcli.api.judging": GIVEN,
    "depthcli.api.maps": GIVEN,
    "depthcli.api.wording": {"stereo", "fuse"},  # options that Python's messages go without
    "depthcli.run": BATCH,
    "depthcli.run.columns": {"stereo"},  # of the column of the device
    "depthcli.commands._page": {"evaluate"},  # of --html-budget; a page of other commands is where --html was given
    "depthcli.api.masks": {"depth", "refine-kinect"},
    "depthcli.run.combinations": {"sweep"},
    "depthcli.commands._old_options": SCENES
    - {"depth", "rectify"},  # where --evaluate was given, and of all options here
    "depthcli.commands._tables": {"evaluate"},
    "depthcli.commands._scenes": SCENES - {"depth", "rectify"},  # where --evaluate or --name was given
    "depthcli.core.config_file": {"stereo", "fuse", "sweep"},  # where --set was given
    "depthcli.io.formats.rigs": {"stereo", "fuse", "rectify"},
    "depthcli.simulate": {"sample"},
    "depthcli.io.layouts": SCENES,
    "depthcli.io.scenes.rgbd": {"refine-kinect", "transparent"},
    "depthcli.io.scenes.stereo": {"stereo", "fuse", "rectify"},
    "depthcli.io.scenes.volume_pair": {"register-confidence"},
    "depthcli.io.walk": SCENES | {"evaluate", "sweep"},
    "depthcli.device": {"stereo"},
    "depthcli.evaluation.protocols": SCENES - {"depth", "rectify"} | {"evaluate"},
    "depthcli.evaluation.printing": {"evaluate"},
    "depthcli.report.page": SCENES - {"rectify"} | {"evaluate", "sweep"},
    "depthcli.methods.stereo.networks": {"stereo"},  # fuse never has a device
    "depthcli.methods.stereo.search_range": {"stereo", "fuse"},  # where the range of key points is taken
    "depthcli.programs": BATCH,
    "depthcli.methods.stereo.matching": {"stereo"},  # of fuse only where there is a device, which it never has
}
# Declarations and examples, not messages; options of compilers; topics of the documentation.
PASSED_OVER = ("depthcli.cli", "depthcli.device.cuda", "depthcli.commands.help", "depthcli.testing")


def texts(tree: ast.AST) -> Iterator[str]:
    """Yield the string literals that are no docstrings, and no fields of an option of the command line."""
    passed: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            passed.add(id(node.value))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Option":
            passed |= {id(each) for each in ast.walk(node)}
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in passed:
            yield node.value


def callers(module: str, reached: dict[str, set[str]]) -> set[str]:
    """Return the commands that may show a message of ``module``."""
    places = [place for place in CALLERS if module == place or module.startswith(f"{place}.")]
    return CALLERS[max(places, key=len)] if places else {name for name in COMMANDS if module in reached[name]}


def test_messages_name_only_options_that_the_command_has():
    """Every option in a text is one of every command that can show the text, by the imports between modules."""
    graph = grimp.build_graph("depthcli")
    modules = {name: f"depthcli.commands.{name.replace('-', '_')}" for name in command_names()}
    own = {
        name: {"--help", "--version", *(o.flag for o in (*_COMMON, *load_command(name).options))} for name in modules
    }
    reached = {}
    for name, module in modules.items():
        alone = copy.deepcopy(graph)
        for other in modules.values():
            if other != module:
                alone.remove_module(other)
        reached[name] = alone.find_upstream_modules(module) | {module}
    wrong, n_options = [], 0
    for file in sorted(ROOT.rglob("*.py")):
        module = ".".join(file.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__")
        if module.startswith(PASSED_OVER):
            continue
        for text in texts(ast.parse(file.read_text("utf-8"))):
            for command, option in OPTION.findall(text):
                shown = {command} if command else callers(module, reached)
                n_options += 1
                if lacking := [name for name in sorted(shown) if option not in own[name]] if shown else ["any"]:
                    wrong.append(f"{module}: {option}, which {', '.join(lacking)} lacks: {text[:60]!r}")
    assert n_options > 100
    assert not wrong, "\n".join(wrong)
