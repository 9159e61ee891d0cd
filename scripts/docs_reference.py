#!/usr/bin/env python3
"""Write docs/reference from the code: commands, presets, methods, data, outputs, columns, Python.

    scripts/docs_reference.py [--check]

``--check`` writes nothing, and fails if a file is not up to date; so does tests/test_docs.py.
"""

import inspect
import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

import _env  # first: continues in the checkout's environment
import typer

import depthcli
from depthcli import testing
from depthcli.cli import command_of
from depthcli.commands import config_model, grouped_names, help_of
from depthcli.core.config_file import find_config, list_presets
from depthcli.core.errors import EXIT_CODES
from depthcli.core.maps import DEPTH_STATUS_HELP, STATUS_HELP, VOLUME_STATUS_HELP
from depthcli.core.method import Family
from depthcli.core.yaml_source import read_config
from depthcli.evaluation import protocols
from depthcli.evaluation.evaluate import RESULTS
from depthcli.io.formats.files import RUN_FILE
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.map_format import MAP_SUFFIXES, map_formats
from depthcli.io.formats.volumes import VOLUME_SUFFIXES
from depthcli.io.scenes.find import ALL_KINDS
from depthcli.methods.confidence import measures as confidence_measures
from depthcli.methods.registration.search import MEASURES
from depthcli.problems import PROBLEMS
from depthcli.report import terms
from depthcli.run.folder import LEGEND_FILE
from depthcli.run.records import REPORT_FILES

METHOD_PACKAGES = [
    *(f"depthcli.methods.{name}" for name in (
        "stereo.pipeline", "stereo.cost", "stereo.aggregation", "stereo.optimization", "stereo.refinement",
        "stereo.boundary",
        "confidence", "fusion.choice", "kinect.pipeline", "transparent.pipeline",
        "registration.pipeline", "registration.feature",
    )),
    "depthcli.algorithms.segmentation", "depthcli.algorithms.keypoints",
]  # fmt: skip
"""Packages of all families of methods, in the order in which they are explained."""
CONFIGS: dict[str, Any] = {command: config_model(command) for command in PROBLEMS}
"""Command -> class of its config."""
MAPS, DEPTH = "disp_left.*, status.png, preview.png, confidence_*", "depth.*, bound.pfm, status.png, preview.png"
OUTPUTS = {
    "In every run folder": {
        RUN_FILE: "the config with all values, versions and seed; itself a config",
        ", ".join(REPORT_FILES): "a row for every scene: status, seconds, memory; see Columns of tables",
        LEGEND_FILE: "the codes of status.png, and a line of code that selects the measured pixels",
        "SCENE/record.json": "inputs and files of a scene, by their digests: by it a run is resumed",
    },
    "In the folder of a scene": {
        "stereo, fuse": f"{MAPS}; with --bound also bound.pfm, probability.pfm",
        "confidence": f"bound.pfm, probability.*, {MAPS}",
        "refine-kinect, transparent, depth": f"{DEPTH}, probability.pfm, confidence_*, points.ply",
        "register-confidence": "confidence.*, expected_error.*, bound.*, status.*, probability.*, shift.*, "
        "preview.png, "
        "points.csv",
        "rectify": "left.png, right.png, calib.txt, meta.json",
        "sample": "*.png, *.pfm, *.nii.gz, meta.json, calib.json",
    },
    "In the folder of an evaluation": {"evaluate": ", ".join(RESULTS)},
    "Disparity maps": {str(int(bit)): text for bit, text in STATUS_HELP.items()},
    "Depth maps": {str(int(bit)): text for bit, text in DEPTH_STATUS_HELP.items()},
    "Registrations (status.nii.gz)": {str(int(bit)): text for bit, text in VOLUME_STATUS_HELP.items()},
    "Exit codes": {str(code): text for code, text in EXIT_CODES.items()},
}
REFERENCE = _env.ROOT / "docs" / "reference"
COLUMNS = read_config(_env.ROOT / "scripts" / "report_columns.yaml").data | {
    heading: {term.headings: term.about for term in named}
    for heading, named in {
        "Metrics (evaluate)": terms.METRICS,
        "Regions (evaluate)": terms.REGIONS,
        "Other columns of evaluate and sweep": terms.TABLES,
        "scores.csv": terms.SCORES,
        "points.csv, points/RUN/SCENE.csv": terms.POINTS,
        "Sensitivity, sweep.csv": terms.SWEEP,
    }.items()
}


def main() -> None:
    check = _env.options(__doc__, check=False).check
    wanted = {REFERENCE / f"{name}.md": text for name, text in pages().items()}
    wanted |= dict.fromkeys(set(REFERENCE.rglob("*.md")) - set(wanted), "")
    stale = [file for file, text in wanted.items() if (file.read_text("utf-8") if file.exists() else "") != text]
    for file in sorted(stale):
        print(f"{file.relative_to(_env.ROOT)}: {'not up to date' if check else 'written'}")
        if not check:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(wanted[file], "utf-8") if wanted[file] else file.unlink()
    sys.exit("run scripts/docs_reference.py" if check and stale else 0)


def pages() -> dict[str, str]:
    """Return name -> Markdown of every page of the reference."""
    families = {_family_name(package): family_page(package) for package in METHOD_PACKAGES}
    found = {
        "command_line": command_line(),
        "python": python_page(),
        "presets": presets(),
        "configs": configs(),
        "data": data(),
        "protocols": protocol_page(),
        "outputs": "# Outputs\n\n" + _sections(OUTPUTS),
        "columns": "# Columns of tables\n\nUnits are in brackets.\n\n" + _sections(COLUMNS),
        "plugins": f"# Tests of plug-ins\n\n{_about(testing)}\n\n"
        + "\n".join(_documented(name, getattr(testing, name)) for name in testing.__all__).replace("### ", "## "),
    }
    methods = _index("Methods", "The exchangeable parts of every command, by family; a config names them.", families)
    index = _index("Reference", "Generated from the code by `scripts/docs_reference.py`.", found)
    index = index.replace("- [Layouts", "- [Methods](methods/index.md)\n- [Layouts")
    texts = {"index": index, **found, "methods/index": methods, **{f"methods/{k}": v for k, v in families.items()}}
    return {name: re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n" for name, text in texts.items()}


def _index(title: str, about: str, found: Mapping[str, str]) -> str:
    links = (f"- [{text.partition(chr(10))[0].removeprefix('# ')}]({name}.md)\n" for name, text in found.items())
    return f"# {title}\n\n{about}\n\n" + "".join(links)


def command_line() -> str:
    """Return the page of all commands with their options."""
    parts = ["# Command line\n\nEvery command has `--help`.\n"]
    for group, names in grouped_names().items():
        parts.append(f"## {group}\n")
        for name in names:
            command = command_of(name)
            context = typer.Context(command)
            records = (each.get_help_record(context) for each in command.get_params(context))
            rows = [(f"`{option}`", text) for option, text in filter(None, records)]
            parts.append(f"### `depthcli {name}`\n\n{help_of(name)}\n\n{_table(('', ''), rows)}")
    return "\n".join(parts)


def presets() -> str:
    """Return the page of all presets with their files."""
    parts = [
        "# Presets\n\n`depthcli presets show COMMAND/NAME` prints one with all values filled in; a file of your own "
        "begins with `base: NAME`.\n"
    ]
    for command, found in groupby(list_presets(), key=itemgetter(0)):
        parts.append(f"\n## `{command}`\n\n")
        for _, name, about in found:
            file = find_config(command, name).relative_to(_env.ROOT)
            parts.append(f"- [`{name}`](../../{file.as_posix()}): {_markdown(about)}\n")
    return "".join(parts)


def configs() -> str:
    """Return the page of the keys that the config of each command has."""
    parts = [
        "# Configs\n\nThese are the keys at the root of a config. The pages of the families have the keys of "
        "methods. Every "
        "config also takes `base`, a preset or file whose keys it inherits, `plugins`, and `symbols`, "
        "short names of keys for `--set` and `--over`, such as `{w: energy.smoothness}`.\n"
    ]
    for command, model in CONFIGS.items():
        parts.append(f"## `{command}`\n\n{_about(model)}\n\n{_fields(model)}")
    return "\n".join(parts)


def family_page(package: str) -> str:
    """Return the page of a family of methods."""
    family = Family.of(package)
    title = _family_name(package).replace("_", " ").capitalize()
    parts = [f"# {title}\n\n{_about(sys.modules[package])}\n\nIn a config: `{family.key}: NAME`. Classes of plug-ins "
             f"derive from one of `{package}`.\n"]  # fmt: skip
    for name in family.own_names:
        method = family.load(name)
        aliases = f" Also called {', '.join(f'`{alias}`' for alias in method.aliases)}." if method.aliases else ""
        source = _about(sys.modules[method.__module__])
        parts.append(f"## `{name}`\n\n{_about(method)}{aliases}\n\n*Source:* {source}\n\n{_fields(method)}")
    measures = {"depthcli.methods.registration.feature": MEASURES, "depthcli.methods.confidence": confidence_measures()}
    if package in measures:
        rows = ((f"`{name}`", about) for name, about in measures[package].items())
        parts.append("## Measures\n\n" + _table(("measure", ""), rows))
    return "\n".join(parts)


def _family_name(package: str) -> str:
    return re.sub(r"^depthcli\.(methods|algorithms)\.", "", package).replace(".", "_")


def _fields(model: Any) -> str:
    """The fields of a config or method as a table: type and bounds, default, meaning."""
    schema = model.model_json_schema()
    rows = []
    for name, field in schema.get("properties", {}).items():
        default = json.dumps(field["default"]) if "default" in field else "required"
        rows.append((f"`{name}`", _kind(field, schema.get("$defs", {})), f"`{default}`", field.get("description", "")))
    return _table(("key", "value", "default", ""), rows) if rows else "No parameters.\n"


def _kind(field: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """The type of a value with its bounds, in a few words."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        inside = ", ".join(f"`{key}`" for key in definitions[name].get("properties", ()))
        return f"mapping of {inside}" if inside else _kind(definitions[name], definitions)
    if "anyOf" in field or "oneOf" in field:
        return " or ".join(dict.fromkeys(_kind(each, definitions) for each in field.get("anyOf", field.get("oneOf"))))
    if "enum" in field or "const" in field:
        return " or ".join(f"`{value}`" for value in field.get("enum", [field.get("const")]))
    bounds = [
        f"{sign} {field[key]:g}"
        for key, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
        if key in field
    ]
    kind = str(field.get("type", "a method"))
    if kind == "array":
        inside = field.get("prefixItems")
        items = [_kind(each, definitions) for each in inside or [field.get("items", {})]]
        return f"{len(items)} × {items[0]}" if inside and len(set(items)) == 1 else f"list of {' and '.join(items)}"
    return " ".join([{"string": "text", "boolean": "true or false"}.get(kind, kind), ", ".join(bounds)]).strip()


def data() -> str:
    """Return the page of layouts and file formats."""
    rows = [(f"`{each.name}`", each.about) for each in ALL_KINDS.with_plugins().rows]
    others = {end: _about(type(of)) for end, of in map_formats().items()}
    maps: dict[str, list[str]] = {}
    for name in protocols.names():
        maps.setdefault(" ".join(protocols.load(name).files.endings), []).append(name)
    codes = f"{' '.join(MAP_SUFFIXES)}: PFM and floats hold pixels or meters, integers codes"
    files = {"images": " ".join(IMAGE_SUFFIXES), "disparity and depth maps": codes, **others}
    sections = {
        "Files, by their endings; the content decides": {**files, "volumes": " ".join(VOLUME_SUFFIXES)},
        "Maps of a run, by the protocol that scores them": {", ".join(which): ends for ends, which in maps.items()},
    }
    text = "# Layouts and formats\n\n## Layouts\n\n"
    text += "A layout is recognized by a folder's files, or set by `--layout NAME`.\n\n"
    return text + _table(("Layout", "Files"), rows) + _sections(sections)


def protocol_page() -> str:
    """Return the page of the protocols of ``evaluate``."""
    parts = [
        "# Protocols\n\nThe rules by which `depthcli evaluate` scores maps. The ground truth "
        "decides which one applies, unless `--protocol NAME` sets another.\n"
    ]
    for name, kind in ((name, protocols.load(name)) for name in protocols.names()):
        shown = kind.presentation
        parts.append(f"## `{name}`\n\n{shown.title}. {shown.note}\n\n{_about(kind, whole=True)}\n")
    return "\n".join(parts)


def python_page() -> str:
    """Return the page of Python's public names, from their docstrings."""
    configs = [model.__name__ for model in CONFIGS.values()]
    names = sorted(set(depthcli.__all__) - {"__version__", *configs})
    functions = [name for name in names if inspect.isroutine(getattr(depthcli, name))]
    errors = [name for name in names if name.endswith("Error")]
    results = [name for name in names if name not in functions and name not in errors]
    parts = ["# Python\n\n`import depthcli` takes milliseconds; what a function needs is loaded when it is called.\n"]
    for title, found in (("Functions", functions), ("Results", results), ("Errors", errors)):
        parts += [f"## {title}\n", *(_documented(name, getattr(depthcli, name)) for name in found)]
    listed = "\n".join(f"- `depthcli.{model.__name__}`: of `{command}`" for command, model in CONFIGS.items())
    parts.append(f"## Configs\n\nPydantic models with the keys of [Configs](configs.md).\n\n{listed}\n")
    return "\n".join(parts)


def _documented(name: str, thing: Any) -> str:
    """The section of a public function or class: its signature, docstring and public methods."""
    place = thing.__module__ if thing.__module__.startswith("depthcli.testing") else "depthcli"
    place = "depthcli.testing" if place != "depthcli" else place
    parts = [f"### `{place}.{name}`\n"]
    if inspect.isroutine(thing):
        parts.append(f"```python\n{_signature(name, thing)}\n```\n")
    parts.append(_docstring(thing))
    for key in vars(thing) if inspect.isclass(thing) and not issubclass(thing, Exception) else ():
        member = inspect.getattr_static(thing, key)
        if key.startswith("_") or not (inspect.isroutine(member) or isinstance(member, property)):
            continue
        shown = _signature(key, member).replace("(self, ", "(").replace("(self)", "()") if callable(member) else key
        parts.append(f"#### `{name}.{key}`\n\n```python\n{shown}\n```\n\n{_docstring(member)}")
    return "\n".join(parts)


def _signature(name: str, function: Any) -> str:
    """The names and defaults of a function's parameters; their types and shapes are in the docstring."""
    signature = inspect.signature(function)
    bare = [each.replace(annotation=inspect.Parameter.empty) for each in signature.parameters.values()]
    text = f"{name}{signature.replace(parameters=bare, return_annotation=inspect.Signature.empty)}".replace("'", '"')
    return text if len(text) <= 100 else text.replace("(", "(\n    ", 1).replace(", ", ",\n    ")[:-1] + ",\n)"


def _docstring(thing: Any) -> str:
    """A docstring in numpy's style as Markdown."""
    text = inspect.getdoc(thing) or ""
    first, *rest = re.split(r"^([A-Z]\w+)\n-{3,}\n", text, flags=re.M)
    parts = [_prose(first)]
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        if title == "Examples":
            parts.append(f"```python\n{body.strip()}\n```\n")
        else:
            entries = re.findall(r"^(\S.*?) : (.*(?:\n(?:[ ]+.*|(?=\n)))*)", body, re.M)
            listed = "\n".join(f"- `{names}`: {_prose(about).strip()}" for names, about in entries)
            parts.append(f"{title}:\n\n{listed or _prose(body)}\n")
    return "\n".join(parts)


def _prose(text: str) -> str:
    """Paragraphs of a docstring as Markdown, with its examples as code."""
    parts = text.strip().split("\n\n")
    return "\n\n".join(f"```python\n{p}\n```" if p.startswith(">>>") else _markdown(p) for p in parts) + "\n"


def _sections(sections: Mapping[str, Mapping[str, str]]) -> str:
    """Headings, each with a table of names and explanations."""
    parts = (f"## {heading}\n\n{_table(('', ''), ((f'`{a}`', b) for a, b in rows.items()))}"
             for heading, rows in sections.items())  # fmt: skip
    return "\n".join(parts)


def _about(thing: Any, whole: bool = False) -> str:
    """The first paragraph of a docstring, or all of it up to its first section, as Markdown."""
    text = inspect.cleandoc(thing.__doc__ or "")
    text = re.split(r"\n\n?[A-Z]\w+\n-{3,}", text)[0]
    return _markdown(text if whole else text.split("\n\n")[0])


def _markdown(text: str) -> str:
    text = re.sub(r":\w+:`~?\.?([^`]+)`", r"`\1`", text).replace("``", "`")
    return "\n\n".join(part if part.startswith("|") else " ".join(part.split()) for part in text.strip().split("\n\n"))


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "".join(f"| {' | '.join(' '.join(cell.split()) for cell in line)} |\n" for line in lines) + "\n"


if __name__ == "__main__":
    main()
