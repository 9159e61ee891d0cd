"""The runs that are evaluated, and where their maps lie: which file is scored for a scene, and which belong to it."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.files import shown
from depthcli.io.formats.map_format import MAP_SUFFIXES, map_formats
from depthcli.io.inputs import local

_N_SHOWN = 5  # patterns, or files, in a message
_MAX_LISTED = 50_000  # files of a run folder that are looked at
# Words in the names of files that are no maps of the left view.
_OTHER_WORDS = re.compile(
    "confidence|conf|uncertainty|sigma|(?<!expected_)errors?|err|masks?|valid|nonocc|occ|noc|disc|right|gt|truth|"
    "groundtruth|preview|status|colou?r|colored|rgb|image|img|im|view|texture|vis|viz|overlay|intensity|fixed|moving"
)
_OTHER_STEMS = ("left", "{scene}_left")


@dataclass(frozen=True)
class MapNaming:
    """How the maps of one run are named and coded, as far as that was given.

    Attributes
    ----------
    pattern : path of the map of ``{scene}`` in the run folder, with its ending; empty: as the protocol's ``MapFiles``
    scale : codes per unit, of maps of any kind; None: as for all runs
    invalid : value that stands for no value; None: as for all runs
    """

    pattern: str = ""
    scale: float | None = None
    invalid: float | None = None

    def files(self, default: MapFiles) -> MapFiles:
        """Return where the maps of the run lie, ``default`` where no pattern was given."""
        return MapFiles((self.pattern,), ("",)) if self.pattern else default


@dataclass(frozen=True)
class MapFiles:
    """Names under which a run folder may hold the maps of its scenes.

    Attributes
    ----------
    places : path of the map of ``{scene}`` in the run folder, without the ending; the first that exists is taken
    suffixes : endings of a map; the first that exists is taken
    other_places : names of other forms that ``candidates`` knows, in words
    """

    places: tuple[str, ...]
    suffixes: tuple[str, ...]
    other_places: tuple[str, ...] = ()

    @property
    def endings(self) -> tuple[str, ...]:
        """All endings of a map: ``suffixes`` and, for maps of one channel, those of plug-ins' formats."""
        return (*self.suffixes, *sorted(map_formats())) if ".pfm" in self.suffixes else self.suffixes

    def candidates(self, folder: Path, scene: str) -> Iterator[Path]:
        """Yield the paths that the map of a scene may have, in order of preference; they need not exist."""
        for place in self.places:
            for suffix in self.endings:
                yield folder / (place.replace("{scene}", scene) + suffix)

    def find(self, folder: Path, names: Sequence[str]) -> Path | None:
        """Return the map of the scene that is called by any of ``names``; None where there is none.

        Raises
        ------
        InputError
            Several files claim to be the map.
        """
        return next((path for name in names for path in self.candidates(folder, name) if os.path.isfile(path)), None)

    def searched(self, names: Sequence[str]) -> str:
        """Return the places that ``find`` looks at, in words for an error message."""
        endings = self.endings
        ending = ".*" if len(endings) > 1 else endings[0]
        named = [*(f"{place}{ending}" for place in self.places), *self.other_places]
        places = ", ".join(named).replace("{scene}", "SCENE")
        short = names[0].rpartition("/")[2]
        several = "" if short in names else f"; several scenes are called {short}, so that the name needs its folder"
        return f" (looked for {places}{several})"

    def confidences(self, path: Path) -> dict[str, Path]:
        """Return name -> file of the confidence maps beside a map: ``confidence_<name>.pfm`` or ``.npy``.

        That of ``confidence.pfm`` is called ``confidence``.
        """
        if not self._in_run_folder(path):
            return {}
        files = sorted(p for p in path.parent.glob("confidence*") if p.suffix.lower() in (".pfm", ".npy"))
        named = (file for file in files if file.stem == "confidence" or file.stem.startswith("confidence_"))
        return {file.stem.removeprefix("confidence_"): file for file in named}

    def status(self, path: Path) -> Path | None:
        """Return the status map beside a map; None where there is none."""
        file = path.parent / "status.png"
        return file if self._in_run_folder(path) and file.is_file() else None

    def _in_run_folder(self, path: Path) -> bool:
        """True where the map is named as in a run folder, so that the files beside it belong to it."""
        return any(Path(place).stem == path.stem for place in self.places)


@dataclass(frozen=True)
class DisparityFiles(MapFiles):
    """Disparity maps of our runs and as the benchmarks' submissions hold them."""

    places: tuple[str, ...] = ("{scene}/disp_left", "{scene}", "disp_0/{scene}", "low_res_two_view/{scene}")
    suffixes: tuple[str, ...] = MAP_SUFFIXES
    other_places: tuple[str, ...] = ("{scene}/disp0METHOD.pfm",)

    def candidates(self, folder: Path, scene: str) -> Iterator[Path]:
        """Yield also result files of the Middlebury v3 kit: ``disp0METHOD.pfm``, else ``disp0METHOD_s.pfm``."""
        yield from super().candidates(folder, scene)
        inside = folder / scene
        kit = sorted(path for path in inside.glob("disp0*.pfm") if not path.stem.startswith("disp0GT"))
        dense = [path for path in kit if not path.stem.endswith("_s")] or kit
        named = [path for path in dense if path.stem == f"disp0{folder.resolve().name}"] or dense
        if len(named) > 1:
            raise InputError(f"{inside}: both {named[0].name} and {named[1].name}; keep one method in a folder")
        yield from named


def found_patterns(folder: Path, scenes: Mapping[str, Sequence[str]], suffixes: Sequence[str]) -> dict[str, list[str]]:
    """Return pattern -> scenes with such a file, of the files that can be maps; those of most scenes first.

    A pattern is the path of a file in the folder with ``{scene}`` in place of the scene's name, such as
    ``{scene}/out/{scene}_final.pfm``. Files that are named as something else (``confidence.pfm``, ``right.png``) and
    such that are named after no scene are left out.

    Parameters
    ----------
    folder : the run folder
    scenes : scene -> names that it may have in file names, the longest form first
    suffixes : endings of maps
    """
    words = [(scene, _whole_word(name)) for scene, names in scenes.items() for name in names]
    made: dict[str, dict[str, None]] = {}
    for path in itertools.islice(map_paths(folder, suffixes), _MAX_LISTED):
        for scene, word in words:
            pattern, n_replaced = word.subn("{scene}", path)
            if n_replaced:
                if not _is_other(pattern):
                    made.setdefault(pattern, {})[scene] = None
                break
    ranked = sorted(made.items(), key=lambda item: (-len(item[1]), item[0]))
    return {pattern: list(scenes) for pattern, scenes in ranked}


def map_paths(folder: Path, suffixes: Sequence[str]) -> Iterator[str]:
    """Yield the paths of the files with these endings in a folder, relative to it, with ``/``, sorted."""
    for place, folders, files in os.walk(folder):
        folders.sort()
        for file in sorted(files):
            if file.lower().endswith(tuple(suffixes)):
                yield Path(place, file).relative_to(folder).as_posix()


def _whole_word(name: str) -> re.Pattern[str]:
    return re.compile(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])")


def _is_other(pattern: str) -> bool:
    """True where the file's name says that it is no map of the left view."""
    stem = pattern.rpartition("/")[2].lower().split(".")[0]
    return stem in _OTHER_STEMS or any(
        not stem[: found.start()][-1:].isalpha() and not stem[found.end() :][:1].isalpha()
        for found in _OTHER_WORDS.finditer(stem)
    )


def find_runs(runs: Sequence[Path | str]) -> dict[str, Path]:
    """Return name -> folder or file of every run.

    Parameters
    ----------
    runs : ``PLACE``, which is called by its folder's name, or ``NAME=PLACE``

    Raises
    ------
    InputError
        There is none, a place does not exist, or two runs have one name.
    """
    given = [_split(str(run)) for run in runs]
    if not given:
        raise InputError("no run to evaluate")
    given = [(name, local(place)) for name, place in given]
    if absent := [place for _, place in given if not os.path.exists(place)]:
        raise InputError(f"{shown(absent[0])}: no such folder")
    places = [place for name, place in given if not name]
    unnamed = iter(run_names(places) if places else [])
    names = [name or next(unnamed) for name, _ in given]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two runs are called {twice[0]}: give one of them another name, NAME=DIR")
    return dict(zip(names, [place for _, place in given], strict=True))


def _split(text: str) -> tuple[str, Path]:
    """Name, or an empty text, and place of a run."""
    name, equals, place = text.partition("=")
    if equals and name and place and not os.path.exists(text) and "/" not in name:
        return name, Path(place)
    return "", Path(text)


def run_names(places: Sequence[Path]) -> list[str]:
    """Return names of folders or files, with as many parents as make them differ; InputError where two are one."""
    parts = [place.resolve().parts for place in places]
    for depth in range(1, max(len(p) for p in parts) + 1):
        names = ["_".join(p[-depth:]).strip("/") or "run" for p in parts]
        if len(set(names)) == len(names):
            return names
    raise InputError("the same run is given twice")


def names_in_run(scene: str, folder: Path | None, unique: bool) -> list[str]:
    """Return the names that a scene may have in a run folder, the longest form first.

    Parameters
    ----------
    folder : that of the scenes, or None
    unique : no other scene has its short name
    """
    of_folder = [] if folder is None else [f"{folder.resolve().name}/{scene}"]
    return [scene, *of_folder, *([scene.rpartition("/")[2]] if unique else [])]


def _has_standard_map(folder: Path, files: MapFiles, names: Sequence[str]) -> bool:
    try:
        return files.find(folder, names) is not None
    except InputError:  # several files claim to be the map: an error of that scene alone
        return True


def recognized(
    run: str,
    folder: Path,
    options: MapNaming,
    scenes: Mapping[str, tuple[MapFiles, Sequence[str]]],
    fits: Callable[[str, Path, MapNaming], bool],
) -> MapNaming:
    """Return the options with the one pattern that the maps of a run have where none has a usual place.

    Parameters
    ----------
    run, folder : name and folder of the run
    options : what was given for the run
    scenes : scene -> where its maps may lie, and the names that it may have in the run folder
    fits : whether a file can be read as the map of a scene with such options

    Raises
    ------
    InputError
        Several patterns are as frequent, and not exactly one of them is that of files that can be read; the message
        names the files and gives a ``--maps``.
    """
    if options.pattern or any(_has_standard_map(folder, *scene) for scene in scenes.values()):
        return options
    suffixes = tuple({suffix: None for files, _ in scenes.values() for suffix in files.endings})
    found = found_patterns(folder, {scene: names for scene, (_, names) in scenes.items()}, suffixes)
    max_scenes = max(map(len, found.values()), default=0)
    likely = [pattern for pattern, of in found.items() if len(of) == max_scenes][:_N_SHOWN]
    if not likely:
        return options
    if len(likely) == 1:
        return MapNaming(likely[0], options.scale, options.invalid)
    fitting = []
    for pattern in likely:
        scene = found[pattern][0]
        chosen = MapNaming(pattern, options.scale, options.invalid)
        path = chosen.files(scenes[scene][0]).find(folder, scenes[scene][1])
        if path is not None and fits(scene, path, chosen):
            fitting.append(chosen)
    if len(fitting) == 1:
        return fitting[0]
    files = ", ".join(path for path, _ in zip(map_paths(folder, suffixes), range(_N_SHOWN), strict=False))
    best = fitting[0].pattern if fitting else likely[0]
    why = f"{len(fitting)} kinds of file can be the maps" if fitting else "no file there can be read as a map"
    raise InputError(f"{shown(folder)}: {why} ({files}, ...); say which: --maps '{run}={best}'")
