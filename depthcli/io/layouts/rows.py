"""Layouts as rows of a table: names of files with placeholders.

``image_2/{frame}_10.png`` names the left images of KITTI, and ``image_3/{frame}_10.png`` the right one of the same
frame. Placeholders match a part of a name, ``{number}`` digits or a time, ``{_}`` anything that the other files do not
have to repeat, and ``{path}`` any folders between; ``.*`` at the end means the endings of the role's kind of file,
and ``|`` separates names that are tried in turn. A row without placeholders describes one scene, the folder itself.
"""

from __future__ import annotations

import fnmatch
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from pydantic import TypeAdapter, ValidationError

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.yaml_source import read_config
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.map_format import MAP_SUFFIXES, map_suffixes
from depthcli.io.layouts.base import Folder, Layout
from depthcli.io.scenes import RgbdScene, Scene, StereoScene

DEPTH_SUFFIXES = (".png", ".pgm", ".tif", ".tiff", ".pfm", ".npy", ".exr")

_PLACEHOLDER = re.compile(r"\{(\w+)\}")
NUMBER = r"\d{9,}\.\d+|\d+"  # of a frame: digits, or the time in seconds, of which the fraction is no number
_MASK = "mask."  # before the name of a mask in a role
_MASKS = "masks"  # role of all masks, whose names are ``{mask}``
_OWN_FIELDS = ("folder", "layout", "problem")  # of scenes, which no file of layouts has
_VIEWS = {StereoScene: ("left", "right"), RgbdScene: ("color", "depth")}
_Keys = dict[str, str]  # placeholder -> text
_Key = tuple[tuple[str, str], ...]  # the same, as pairs


class Found(NamedTuple):
    """The files of one scene that a row has found in the folder that it describes."""

    folder: Folder
    keys: Mapping[str, str]  # placeholder -> text
    files: Mapping[str, Path]  # role -> file
    masks: Mapping[str, Path]  # name -> file


@dataclass(frozen=True, kw_only=True, eq=False)
class LayoutRow(Layout):
    """A layout as a row.

    Attributes
    ----------
    files : role -> file name, of each variant; a scene that an earlier variant found is not found again. ``name`` is
        that of the scene: ``{folder}`` is the folder's own, which is the default, ``{path_}`` folders joined by ``_``
    kind, protocol : of the scenes
    facts : returns further fields of a scene, or None where it is none of this layout
    needs, without : names in the folder, all or none of which must be there (shell patterns)
    """

    title: str  # name on the command line
    wants: str  # the files of a scene, in a line for messages and the manual
    files: tuple[Mapping[str, str], ...]
    kind: type[Scene] = StereoScene
    protocol: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)  # other fields of the scenes
    facts: Callable[[Found], dict[str, Any] | None] = lambda found: {}
    needs: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    either: bool = False  # each of the two images makes a scene, which has a problem without the other
    single: bool = False  # the left image alone is a scene where its truth is known, and so is depth without color

    @property
    def name(self) -> str:
        return self.title

    def scenes(self, folder: Folder) -> list[Scene]:
        scenes: dict[str, Scene] = {}
        for variant in _possible(self, folder.names):
            for keys, views in self._found(folder, variant):
                scene = self._scene(folder, variant, keys, views)
                if scene is not None:
                    scenes.setdefault(scene.name, scene)
        return list(scenes.values())

    @cached_property
    def _views(self) -> tuple[str, str]:
        return next(roles for kind, roles in _VIEWS.items() if issubclass(self.kind, kind))

    def _found(self, folder: Folder, variant: Mapping[str, str]) -> Iterator[tuple[_Keys, dict[str, Path]]]:
        """Yield placeholders and the two images of every scene."""
        first, second = self._views
        one = _files(folder, first, variant.get(first, ""))
        if not one and (not self.either or "{" in variant[second]):
            return  # before the others are asked, whose names may make no sense in this layout
        other = _files(folder, second, variant.get(second, ""))
        if self.either and "{" in variant[second] and not one.keys() & other.keys():
            return
        for key in {**one, **other} if self.either else one:
            views = {role: files[key] for role, files in ((first, one), (second, other)) if key in files}
            digits = re.search(rf"({NUMBER})\D*$", next(iter(views.values())).stem)
            yield dict(key) | ({"number": digits[1]} if digits and "number" in dict(key) else {}), views

    def _scene(self, folder: Folder, variant: Mapping[str, str], keys: _Keys, views: dict[str, Path]) -> Scene | None:
        others = {role: name for role, name in variant.items() if role not in (*self._views, _MASKS, "name")}
        files = {role: file for role, name in others.items() if (file := _file(folder, role, name, keys)) is not None}
        masks = {role.removeprefix(_MASK): files.pop(role) for role in list(files) if role.startswith(_MASK)}
        if _MASKS in variant:
            all_masks = _matches(folder, variant[_MASKS].format_map(_Keep(keys)), IMAGE_SUFFIXES)
            masks |= {found["mask"]: file for found, file in all_masks}
        facts = self.facts(Found(folder, keys, files | views, masks))
        if facts is None:
            return None
        path_ = f"{keys['path']}_".replace("/", "_") if keys.get("path") else ""
        scene_name = variant.get("name", "{folder}")
        name = scene_name.format(**{**keys, "folder": folder.name, "path_": path_})
        values = {
            "name": name if "{folder}" in scene_name else folder.prefix + name,
            "masks": masks, **self.values, **files, **views,
            **self._absent(folder, variant, keys, views, "disparity_left" in files), **facts,
        }  # fmt: skip
        return self.scene(folder, **values)

    def _absent(
        self, folder: Folder, variant: Mapping[str, str], keys: _Keys, views: Mapping[str, Path], has_truth: bool
    ) -> dict[str, Any]:
        """Return the problem of a scene without one of its images, and where that would be."""
        absent = next((role for role in self._views if role not in views), None)
        if absent is None:
            return {}
        if self.single and (absent == "color" or (absent == "right" and has_truth)):
            return {absent: None}
        name = variant[absent].partition("|")[0].format_map(_Keep(keys))
        half = f"a frame without its {absent}" if "color" in self._views else "only one image of the pair"
        there = next(iter(views.values())) if keys else folder.path
        expected = None if absent == "right" else folder.path / name.replace(".*", ".png")
        return {"problem": f"{there}: {half}, no {name}", absent: expected}


class _Keep(dict[str, str]):
    """Placeholders that are filled; others stay."""

    def __missing__(self, key: str) -> str:
        return "" if key == "_" else f"{{{key}}}"


@lru_cache(maxsize=1024)  # folders of thousands of scenes have the same names in them
def _possible(row: LayoutRow, there: frozenset[str]) -> tuple[Mapping[str, str], ...]:
    """Return the variants of which a folder with these names may have an image."""

    def is_there(*patterns: str) -> bool:
        return any(fnmatch.filter(there, each) for each in patterns)

    if not all(map(is_there, row.needs)) or is_there(*row.without):
        return ()
    possible = []
    for variant in row.files:
        names = [name for role in row._views for name in variant.get(role, "").split("|")]
        if is_there(*(_PLACEHOLDER.sub("*", name.partition("/")[0]) for name in names)):
            possible.append(variant)
    return tuple(possible)


def _suffixes(role: str, endings: Sequence[str] = ("",)) -> tuple[str, ...]:
    """Return the endings of a role's files; of maps only our own where ``endings`` are, since plug-ins take long."""
    if role.startswith("disparity"):
        return MAP_SUFFIXES if all(ending in MAP_SUFFIXES for ending in endings) else map_suffixes()
    return DEPTH_SUFFIXES if role.startswith(("depth", "sparse")) else IMAGE_SUFFIXES


def _file(folder: Folder, role: str, names: str, keys: _Keys) -> Path | None:
    """Return the file of a role, by the first of the names that is there."""
    for name in names.split("|"):
        place, _, last = name.format_map(_Keep(keys)).rpartition("/")
        below, found = folder.below(place), None
        if below is not None and last.endswith(".*"):
            endings = below.endings(last[:-2])
            found = below.one(last[:-2], _suffixes(role, endings)) if endings else None
        elif below is not None and last in below.names and os.path.isfile(below.path / last):
            found = below.path / last
        if found is not None:
            return found
    return None


def _files(folder: Folder, role: str, names: str) -> dict[_Key, Path]:
    """Return placeholders -> file of a role, by the first of the names that any file has."""
    for name in names.split("|"):
        known: dict[_Key, Path] = {}
        if "{" not in name and (single := _file(folder, role, name, {})) is not None:
            known[()] = single
        for keys, file in _matches(folder, name, _suffixes(role)) if "{" in name else ():
            # 7 and 007 are a pair.
            key = tuple((k, str(int(v)) if k == "number" and v.isdigit() else v) for k, v in keys.items())
            if (other := known.setdefault(key, file)) is not file:
                raise InputError(f"{file.parent}: both {other.name} and {file.name}; keep one")
        if known:
            return known
    return {}


def _matches(folder: Folder, name: str, suffixes: tuple[str, ...]) -> Iterator[tuple[_Keys, Path]]:
    """Yield placeholders and path of every file whose name matches, by folders from the first part on."""
    part, _, rest = name.partition("/")
    if rest:
        for keys, place in _folders(folder, part):
            for more, file in _matches(place, rest, suffixes):
                yield keys | more, file
        return
    any_ending = part.endswith(".*")
    pattern = _pattern(part.removesuffix(".*"))
    for each in sorted(folder.names):
        stem, ending = os.path.splitext(each)
        match = pattern.fullmatch(stem if any_ending else each)
        if match is not None and (not any_ending or ending.lower() in suffixes):
            yield match.groupdict(), folder.path / each


def _folders(folder: Folder, part: str) -> Iterator[tuple[_Keys, Folder]]:
    """Yield placeholders and folder of every folder in this one whose name matches; ``{path}`` is this one, too."""
    if part == "{path}":
        yield {"path": ""}, folder
        for path in sorted(path for path in folder.path.rglob("[!.]*") if path.is_dir()):
            text = path.relative_to(folder.path).as_posix()
            yield {"path": text}, Folder(path, folder.name, folder.prefix)
        return
    for name in sorted(folder.names) if "{" in part else (part,):
        match = _pattern(part).fullmatch(name)
        if match is not None and (place := folder.below(name)) is not None:
            yield match.groupdict(), place


@lru_cache
def _pattern(name: str) -> re.Pattern[str]:
    """Return the regular expression of a name with placeholders."""
    pieces = _PLACEHOLDER.split(name)
    kinds = {"number": rf"(?P<number>{NUMBER})", "_": ".*?"}
    made = [re.escape(p) if k % 2 == 0 else kinds.get(p, f"(?P<{p}>.+?)") for k, p in enumerate(pieces)]
    return re.compile("".join(made))


def rows_in_file(path: Path) -> tuple[LayoutRow, ...]:
    """Return the layouts of a user's YAML file: name -> role -> file name, and other fields of scenes."""
    rows = []
    for title, given in read_config(path).data.items():
        if not isinstance(given, dict) or not {"left", "depth"} & given.keys():
            raise ConfigError(f"{path}: {title}: expected roles and file names, left or depth among them")
        kind: type[Scene] = StereoScene if "left" in given else RgbdScene
        types = {each.name: str(each.type) for each in fields(kind) if each.name not in _OWN_FIELDS}
        files: dict[str, str] = {}
        values: dict[str, Any] = {"protocol": "middlebury_v2" if kind is StereoScene else "depth", "name": ""}
        hints = get_type_hints(kind)
        for key, value in given.items():
            if "Path" not in types.get(key, "") and not str(key).startswith(_MASK):
                if key not in types:
                    known = ", ".join(sorted([*types, f"{_MASK}NAME"]))
                    raise ConfigError(f"{path}: {title}: no field is called {key!r}; one of: {known}")
                try:
                    values[key] = TypeAdapter(hints[key]).validate_python(value)
                except ValidationError as error:
                    raise ConfigError(f"{path}: {title}: {key}: {error.errors()[0]['msg']}") from error
            elif key == _MASKS and "{mask}" not in str(value):
                raise ConfigError(
                    f"{path}: {title}: {key}: expected {{mask}} in the name; of one mask say {_MASK}NAME: FILE"
                )
            elif isinstance(value, str):
                files[key] = value
            else:
                raise ConfigError(f"{path}: {title}: {key}: expected the name of a file, got {value!r}")
        first = files.get("left") or files.get("color") or files["depth"]
        placeholders = [each for each in _PLACEHOLDER.findall(first) if each != "_"]
        files["name"] = values.pop("name") or "_".join(f"{{{each}}}" for each in placeholders) or "{folder}"
        files["name"] = files["name"].replace("{path}_", "{path_}")
        rows.append(
            LayoutRow(
                title=str(title), wants=f"the files of {path.name}", kind=kind, files=(files,),
                protocol=values.pop("protocol"), values=values,
            )
        )  # fmt: skip
    return tuple(rows)
