"""Layouts of scenes: rows of file names with placeholders, and classes that look into folders themselves.

``image_2/{frame}_10.png`` names the left images of KITTI, and ``image_3/{frame}_10.png`` the right image of the same
frame. A placeholder matches a part of a name: ``{number}`` matches digits or a time, ``{_}`` any text that the other
files need not repeat, and ``{path}`` any folders between. ``.*`` at the end stands for the endings that the role
allows, and ``|`` separates alternatives, tried in turn. A row without placeholders describes the folder as one scene.
"""

from __future__ import annotations

import contextlib
import fnmatch
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar, get_type_hints

from pydantic import TypeAdapter, ValidationError

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.plugins import Plugin, Registry, loaded, plugins_of, registered_name
from depthcli.core.text import short
from depthcli.core.yaml_source import read_config
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.map_format import MAP_SUFFIXES, format_plugins, map_suffixes
from depthcli.io.formats.plain_text import json_object
from depthcli.io.scenes.kinds import RgbdScene, Scene, StereoScene

SceneT = TypeVar("SceneT", bound=Scene)

NUMBER = r"\d{9,}\.\d+|\d+"
"""Pattern of a frame's number: digits, or a time in seconds with its fraction."""

_DEPTH_SUFFIXES = (".png", ".pgm", ".tif", ".tiff", ".pfm", ".npy", ".exr")
_MAX_POSITIVE, _MAX_WHOLE = 1e6, 1 << 20  # limits of numbers in meta.json; no image is as wide
_PLACEHOLDER = re.compile(r"\{(\w+)\}")
_FILE_TYPES = (Path, Path | None, dict[str, Path])  # of scene fields that a file is found for
_MASK = "mask."  # prefix of the role of one mask
_MASKS = "masks"  # role of all masks; ``{mask}`` is the name
_OWN_FIELDS = ("folder", "layout", "problem", "decode")  # scene fields that a user's layout cannot set
_VIEWS = {StereoScene: ("left", "right"), RgbdScene: ("color", "depth")}

Texts = dict[str, str]
"""Placeholder -> its text in a path."""
_Key = tuple[tuple[str, str], ...]  # items of Texts


@dataclass(eq=False)
class Folder:
    """The names in a folder, for layouts; hidden ones are left out. Raise InputError if the folder cannot be read.

    ``name`` is the scene's name if the folder itself is a scene. ``prefix`` begins the names of scenes inside.
    ``requested`` is the layout that the user named, or empty.
    """

    path: Path
    name: str
    prefix: str
    requested: str = ""
    names: frozenset[str] = field(init=False, repr=False)
    folders: list[str] = field(init=False, repr=False)  # sorted names of subfolders
    _below: dict[str, Folder | None] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        names, folders = [], []
        try:
            with naming(self.path), os.scandir(self.path) as entries:
                for entry in entries:
                    if entry.name[0] != ".":
                        names.append(entry.name)
                        with contextlib.suppress(OSError):  # a link to itself
                            folders += [entry.name] * entry.is_dir()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read ({error.strerror or error})") from error
        self.names, self.folders = frozenset(names), sorted(folders)

    def has(self, *names: str) -> bool:
        """Return whether the folder has all of the names."""
        return set(names) <= self.names

    def one(self, stem: str, suffixes: Container[str]) -> Path | None:
        """Return the file with this stem, or None. Raise InputError if several files have it."""
        files = _by_stem(self.names).get(stem)
        if files is None:  # the usual case: every layout looks for its own names
            return None
        fitting = [name for suffix, name in files if suffix in suffixes and name not in self.folders]
        if len(fitting) > 1:
            raise InputError(f"{self.path}: both {fitting[0]} and {fitting[1]}; keep one")
        return self.path / fitting[0] if fitting else None

    def below(self, place: str) -> Folder | None:
        """Return the folder at a path below this one, or None."""
        if not place:
            return self
        if place not in self._below:
            path = self.path / place
            if ".." in place:
                path = Path(os.path.normpath(path))
            self._below[place] = Folder(path, self.name, self.prefix) if os.path.isdir(path) else None
        return self._below[place]

    @cached_property
    def meta(self) -> Meta:
        """The non-null fields of ``meta.json``, or no fields if there is no such file."""
        path = self.path / "meta.json"
        if path.name not in self.names:
            return Meta(path, {})
        data = read_bytes(path)
        with naming(path):
            values = json_object(data)
        return Meta(path, {key: value for key, value in values.items() if value is not None})


@lru_cache(maxsize=8)  # the folders of thousands of scenes contain the same names
def _by_stem(names: frozenset[str]) -> dict[str, list[tuple[str, str]]]:
    """Return stem -> [(ending in lower case, name)], sorted by name; endings are pathlib's, and ``.nii.gz``."""
    by_stem: dict[str, list[tuple[str, str]]] = {}
    for name in sorted(names):
        dot = name.rfind(".")
        dot = dot if 0 < dot < len(name) - 1 else len(name)
        if name.lower().endswith(".nii.gz") and dot > 4:
            dot -= 4
        by_stem.setdefault(name[:dot], []).append((name[dot:].lower(), name))
    return by_stem


class Meta(NamedTuple):
    """Checked fields of a ``meta.json``; methods return None or their default if a field is missing."""

    path: Path
    fields: dict[str, Any]

    def positive(self, key: str) -> float | None:
        """Return a positive number below a million."""
        value = self.fields.get(key)
        if value is not None and (type(value) not in (int, float) or not 0 < value < _MAX_POSITIVE):
            raise self.error(key, "a positive number")
        return None if value is None else float(value)

    def whole(self, key: str, low: int = -_MAX_WHOLE) -> int | None:
        """Return a whole number of at least ``low``."""
        value = self.fields.get(key)
        if value is not None and (type(value) not in (int, float) or value % 1 or not low <= value <= _MAX_WHOLE):
            raise self.error(key, f"a whole number from {low} to {_MAX_WHOLE}")
        return None if value is None else int(value)

    def text(self, key: str, default: str) -> str:
        """Return the text of the field ``key``, or ``default``."""
        value = self.fields.get(key, default)
        if not isinstance(value, str):
            raise self.error(key, "a word")
        return value

    def disparities(self) -> dict[str, int | None]:
        """Return a pair's disparity range as fields of its scene."""
        low, top = self.whole("min_disparity") or 0, self.whole("max_disparity")
        if top is not None and top <= low:
            raise self.error("max_disparity", f"a number above {low}")
        return {"min_disparity": low, "max_disparity": top}

    def error(self, key: str, wanted: str) -> InputError:
        """Return an error with the message that the field ``key`` must be ``wanted``."""
        return InputError(f"{self.path}: {key}: expected {wanted} (got {short(self.fields.get(key))})")


class Layout(ABC):
    """A folder structure: a row of a table, or a class that looks for the files itself."""

    kind: type[Scene]
    about: str
    """The files of a scene, in one line for messages and the manual."""
    protocol: str = ""
    """Default evaluation protocol of its scenes."""
    needs: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    """Shell patterns of names, ``|`` between alternatives: a folder has all of ``needs`` and none of ``without``."""

    @property
    def name(self) -> str:
        """Name on the command line: the registered name with dashes."""
        return registered_name(type(self)).replace("_", "-")

    @abstractmethod
    def scenes(self, folder: Folder) -> list[Scene]:
        """Return the scenes of ``folder`` itself, or an empty list if it does not have this layout.

        Only folders with the names of ``needs`` are given.
        """

    def scene(self, folder: Folder, /, **values: Any) -> Scene:
        """Return a scene with these fields, without looking for its files; the default name is the folder's."""
        common = {"name": folder.name, "folder": folder.path, "layout": self.name, "protocol": self.protocol}
        return self.kind(**{**common, **values})


PLUGINS = Registry[Layout](__name__)
"""The layouts of plug-ins; the package's own layouts are rows of tables."""


@dataclass(frozen=True)
class Layouts(Generic[SceneT]):
    """The layouts of one kind of scene."""

    kind: type[SceneT]
    rows: tuple[Layout, ...]

    @classmethod
    def of(cls, kind: type[SceneT], *rows: Layout) -> Layouts[SceneT]:
        """Return layouts sorted by name."""
        return cls(kind, tuple(sorted(rows, key=lambda row: row.name)))

    def of_kind(self, kind: type[Scene]) -> Layouts[Any]:
        """Return the layouts of a subclass."""
        return Layouts(kind, tuple(row for row in self.rows if issubclass(row.kind, kind)))

    def with_plugins(self) -> Layouts[SceneT]:
        """Return these layouts, followed by the plug-ins' layouts of this kind."""
        added = (PLUGINS.load(name)() for name in PLUGINS.names())
        return replace(self, rows=(*self.rows, *(row for row in added if issubclass(row.kind, self.kind))))


def plugins_of_scenes(scenes: Iterable[Scene], files: Iterable[Path]) -> set[Plugin]:
    """Return the plug-ins with a layout of any of these scenes, or with a format of any of these files."""
    names = {scene.layout for scene in scenes}
    layouts = (kind for name, kind in PLUGINS.added.items() if name.replace("_", "-") in names)
    return plugins_of(layouts) | format_plugins(files)


class Found(NamedTuple):
    """The files of one scene that a row found in a folder."""

    folder: Folder
    keys: Mapping[str, str]  # placeholder -> text
    files: Mapping[str, Path]  # role -> file
    masks: Mapping[str, Path]  # name -> file


@dataclass(frozen=True, kw_only=True, eq=False)
class LayoutRow(Layout):
    """A layout as a row.

    Attributes
    ----------
    files : role -> file name, for each variant; earlier variants take precedence. ``name`` is the scene's name:
        ``{folder}`` (default) is the folder's name, and ``{path_}`` the folders of ``{path}`` joined by ``_``
    kind, protocol : kind and evaluation protocol of the scenes
    facts : returns further fields of a scene, or None if the scene does not have this layout
    after : returns all scenes of a folder with further fields
    """

    title: str  # name on the command line
    about: str  # the files of a scene, in one line for messages and the manual
    files: tuple[Mapping[str, str], ...] = ()
    kind: type[Scene] = StereoScene
    protocol: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)  # other fields of the scenes
    facts: Callable[[Found], dict[str, Any] | None] = lambda found: {}
    after: Callable[[Folder, list[Scene]], list[Scene]] | None = None
    needs: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    either: bool = False  # one image makes a scene, which has a problem if the other image is missing
    single: bool = False  # a left image with ground truth is a valid scene, and so is depth without color

    @property
    def name(self) -> str:
        return self.title

    def scenes(self, folder: Folder) -> list[Scene]:
        scenes: dict[str, Scene] = {}
        for variant in _possible(self, folder.names):
            views_of: dict[str, dict[str, Path]] = {}
            for texts, views in self._pairs(folder, variant):
                scene = self._scene(folder, variant, texts, views)
                if scene is not None and scene.name not in scenes:
                    scenes[scene.name] = scene
                    views_of[scene.name] = views
            for name, line in dropped(self._views, views_of).items() if len(views_of) > 1 else ():
                scenes[name] = replace(scenes[name], warnings=(*scenes[name].warnings, line))
        found = list(scenes.values())
        return self.after(folder, found) if found and self.after else found

    @cached_property
    def _views(self) -> tuple[str, str]:
        return next(roles for kind, roles in _VIEWS.items() if issubclass(self.kind, kind))

    def _pairs(self, folder: Folder, variant: Mapping[str, str]) -> Iterator[tuple[Texts, dict[str, Path]]]:
        """Yield the placeholders and the images of every scene."""
        first, second = self._views
        lefts = _by_texts(folder, first, variant.get(first, ""))
        if not lefts and (not self.either or "{" in variant.get(second, "")):
            return  # before the second image is searched: its name may make no sense in this folder
        rights = _by_texts(folder, second, variant.get(second, ""))
        if self.either and "{" in variant.get(second, "") and not lefts.keys() & rights.keys():
            return
        for key in {**lefts, **rights} if self.either else lefts:
            texts, views = dict(key), dict[str, Path]()
            if key in lefts:
                views[first] = lefts[key]
            if key in rights:
                views[second] = rights[key]
            if "number" in texts and (digits := re.search(rf"({NUMBER})\D*$", next(iter(views.values())).stem)):
                texts["number"] = digits[1]
            yield texts, views

    def _scene(self, folder: Folder, variant: Mapping[str, str], texts: Texts, views: dict[str, Path]) -> Scene | None:
        files, masks = dict(views), {}
        for role, names in variant.items():
            if role == _MASKS:
                for match, mask in _matches(folder, role, _filled(names, texts) if texts else names):
                    masks[match["mask"]] = mask
            elif role not in self._views and role != "name" and (file := _file(folder, role, names, texts)) is not None:
                if role.startswith(_MASK):
                    masks[role.removeprefix(_MASK)] = file
                else:
                    files[role] = file
        facts = self.facts(Found(folder, texts, files, masks))
        if facts is None:
            return None
        absent = self._absent(folder, variant, texts, views, "disparity_left" in files) if len(views) < 2 else {}
        name = _name(folder, variant["name"], texts) if "name" in variant else folder.name
        return self.scene(folder, **{"name": name, "masks": masks, **self.values, **files, **absent, **facts})

    def _absent(
        self, folder: Folder, variant: Mapping[str, str], texts: Texts, views: Mapping[str, Path], has_truth: bool
    ) -> dict[str, Any]:
        """Return the problem of a scene with one image, and the expected path of the other."""
        absent = next(role for role in self._views if role not in views)
        if self.single and (absent == "color" or (absent == "right" and has_truth)):
            return {absent: None}
        name = _filled(variant[absent].partition("|")[0], texts)
        half = f"a frame without its {absent}" if "color" in self._views else "only one image of the pair"
        there = next(iter(views.values())) if texts else folder.path
        expected = None if absent == "right" else folder.path / name.replace(".*", ".png")
        return {"problem": f"{there}: {half}, no {name}", absent: expected}


def dropped(roles: tuple[str, str], scenes: Mapping[str, Mapping[str, Path]]) -> dict[str, str]:
    """Return name -> warning for pairs from two gapless folders of numbered frames with different numbers.

    A frame may have been dropped in one folder and the later frames renumbered. A gap would show which one is missing.
    """
    first, second = roles
    both = {(views[first].parent, views[second].parent) for views in scenes.values() if len(views) == 2}
    pair_of = {folder: folders for folders in both for folder in folders}
    groups: dict[tuple[Path, Path], list[str]] = {}
    for name, views in scenes.items():
        if (folders := pair_of.get(next(iter(views.values())).parent)) is not None:
            groups.setdefault(folders, []).append(name)
    warned: dict[str, str] = {}
    for folders, names in groups.items():
        files = [[scenes[name][role] for name in names if role in scenes[name]] for role in roles]
        numbers = [[int(n[1]) for file in some if (n := re.search(r"(\d{1,15})\D*$", file.stem))] for some in files]
        counts = [len(some) for some in files]
        gapless = all(
            len(some) == count > 1 and max(some) - min(some) + 1 == count
            for some, count in zip(numbers, counts, strict=True)
        )
        if gapless and set(numbers[0]) != set(numbers[1]):
            line = (
                f"{folders[0]}: {counts[0]} {first} and {counts[1]} {second} images: if one was dropped and the rest "
                "numbered anew, all frames after it are paired with others than their own"
            )
            warned |= {name: line for name in names if len(scenes[name]) == 2}
    return warned


def _name(folder: Folder, name: str, texts: Texts) -> str:
    """Return the name of a scene. The folder's prefix is left out if the name contains ``{folder}``."""
    folders = f"{texts['path']}_".replace("/", "_") if texts.get("path") else ""
    filled = _filled(name, {**texts, "folder": folder.name, "path_": folders})
    return filled if "{folder}" in name else folder.prefix + filled


def _filled(name: str, texts: Mapping[str, str]) -> str:
    """Return a name with its placeholders replaced by their texts; unknown placeholders stay."""
    for placeholder, text in texts.items():
        name = name.replace(f"{{{placeholder}}}", text)
    return name.replace("{_}", "")


@lru_cache(maxsize=1024)  # the folders of thousands of scenes contain the same names
def fitting(rows: tuple[Layout, ...], there: frozenset[str]) -> tuple[Layout, ...]:
    """Return the layouts that a folder with these names may have."""
    return tuple(row for row in rows if all(_has(there, each) for each in row.needs) and not _has(there, *row.without))


@lru_cache(maxsize=1024)
def _possible(row: LayoutRow, there: frozenset[str]) -> tuple[Mapping[str, str], ...]:
    """Return the variants whose images a folder with these names may have."""
    possible = []
    for variant in row.files:
        images = [variant.get(role, "") for role in row._views]
        first = (_PLACEHOLDER.sub("*", name.partition("/")[0]) for each in images for name in each.split("|"))
        if _has(there, *first):
            possible.append(variant)
    return tuple(possible)


def _has(there: Iterable[str], *patterns: str) -> bool:
    """Return whether one of the names matches one of the patterns."""
    return any(fnmatch.filter(there, name) for each in patterns for name in each.split("|"))


def _suffixes(role: str) -> Container[str]:
    """Return the endings of a role's files."""
    if role.startswith("disparity"):
        return map_suffixes() if loaded else MAP_SUFFIXES
    return _DEPTH_SUFFIXES if role.startswith(("depth", "sparse")) else IMAGE_SUFFIXES


def _file(folder: Folder, role: str, names: str, texts: Mapping[str, str]) -> Path | None:
    """Return the file of the first of the names that exists, or None."""
    for name in names.split("|"):
        place, _, last = (_filled(name, texts) if texts else name).rpartition("/")
        inside, file = folder.below(place), None
        if inside is None:
            continue
        if last.endswith(".*"):
            file = inside.one(last[:-2], _suffixes(role))
        elif last in inside.names and os.path.isfile(inside.path / last):
            file = inside.path / last
        if file is not None:
            return file
    return None


def _matches(folder: Folder, role: str, names: str) -> list[tuple[Texts, Path]]:
    """Return the files of a role below a folder that match the first of the names with any match.

    Names have placeholders; ``.*`` at the end matches the endings that the role allows.
    """
    for name in names.split("|"):
        if (placeholder := _PLACEHOLDER.search(name)) is None:
            if (file := _file(folder, role, name, {})) is not None:
                return [({}, file)]
            continue
        head, slash, _ = name[: placeholder.start()].rpartition("/")
        root = folder.below(head)
        *parts, last = name[len(head + slash) :].split("/")
        places: list[tuple[Texts, Folder]] = [] if root is None else [({}, root)]
        for part in parts:
            places = [(texts | more, inside) for texts, place in places for more, inside in _folders(place, part)]
        any_suffix = last.endswith(".*")
        pattern, suffixes = _pattern(last.removesuffix(".*") if any_suffix else last), _suffixes(role)
        files = []
        for texts, place in places:
            for entry in sorted(place.names):
                stem, suffix = os.path.splitext(entry)
                match = pattern.fullmatch(stem if any_suffix else entry)
                if match is not None and (suffix.lower() in suffixes or not any_suffix):
                    files.append((texts | _texts(match), place.path / entry))
        if files:
            return files
    return []


def _folders(folder: Folder, part: str) -> Iterator[tuple[Texts, Folder]]:
    """Yield the placeholders and folder of each matching subfolder; ``{path}`` matches ``folder`` itself, too."""
    if part == "{path}":
        yield {"path": ""}, folder
        for path in sorted(path for path in folder.path.rglob("[!.]*") if path.is_dir()):
            yield {"path": path.relative_to(folder.path).as_posix()}, Folder(path, folder.name, folder.prefix)
        return
    pattern = _pattern(part)
    for name in folder.folders if "{" in part else (part,):
        match = pattern.fullmatch(name)
        if match is not None and (place := folder.below(name)) is not None:
            yield _texts(match), place


def _texts(match: re.Match[str]) -> Texts:
    """Return the texts of placeholders; numbers lose leading zeros."""
    texts = match.groupdict()
    if texts.get("number", "").isdigit():
        texts["number"] = str(int(texts["number"]))
    return texts


def _by_texts(folder: Folder, role: str, names: str) -> dict[_Key, Path]:
    """Return texts of the placeholders -> file. Raise InputError if two files have the same."""
    by_texts: dict[_Key, Path] = {}
    for texts, file in _matches(folder, role, names):
        if (other := by_texts.setdefault(tuple(texts.items()), file)) is not file:
            raise InputError(f"{file.parent}: both {other.name} and {file.name}; keep one")
    return by_texts


@lru_cache
def _pattern(name: str) -> re.Pattern[str]:
    """Return the regular expression for a part of a name with placeholders."""
    groups = {"number": rf"(?P<number>{NUMBER})", "_": ".*?"}
    pieces = enumerate(_PLACEHOLDER.split(name))
    return re.compile("".join(groups.get(each, f"(?P<{each}>.+?)") if k % 2 else re.escape(each) for k, each in pieces))


def name_of_file(file: Path, *generic: str) -> str:
    """Return the name of a single scene: the file's stem, or the folder's name if the stem is generic."""
    folder, stem = file.absolute().parent.name, file.stem
    if file.suffix.lower() == ".gz":  # drop both endings: scan.nii.gz becomes scan
        stem = Path(stem).stem
    return folder if stem.lower() in generic and folder else stem


def rows_in_file(path: Path) -> tuple[LayoutRow, ...]:
    """Return the layouts in a user's YAML file: name -> role -> file name, with other fields of scenes."""
    rows = []
    for title, given in read_config(path).data.items():
        if not isinstance(given, dict) or not {"left", "depth"} & given.keys():
            raise ConfigError(f"{path}: {title}: expected roles and file names, left or depth among them")
        kind: type[Scene] = StereoScene if "left" in given else RgbdScene
        hints = get_type_hints(kind)
        types = {each.name: hints[each.name] for each in fields(kind) if each.name not in _OWN_FIELDS}
        files: dict[str, str] = {}
        values: dict[str, Any] = {"protocol": "middlebury_v2" if kind is StereoScene else "depth", "name": ""}
        for key, value in given.items():
            if types.get(key) not in _FILE_TYPES and not str(key).startswith(_MASK):
                if key not in types:
                    known = ", ".join(sorted([*types, f"{_MASK}NAME"]))
                    raise ConfigError(f"{path}: {title}: no field is called {key!r}; one of: {known}")
                try:
                    values[key] = TypeAdapter(types[key]).validate_python(value)
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
                title=str(title), about=f"the files of {path.name}", kind=kind, files=(files,),
                protocol=values.pop("protocol"), values=values,
            )
        )  # fmt: skip
    return tuple(rows)
