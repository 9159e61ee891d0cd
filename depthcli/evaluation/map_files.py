"""Where the maps of a run lie: which file is scored for a scene, and which files beside it belong to it."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.map_format import MAP_SUFFIXES, map_formats

_MAX_LISTED = 50_000  # files of a run folder that are looked at
# Words in the names of files that are no maps of the left view.
_OTHER_WORDS = re.compile(
    "confidence|conf|uncertainty|sigma|(?<!expected_)errors?|err|masks?|valid|nonocc|occ|noc|disc|right|gt|truth|"
    "groundtruth|preview|status|colou?r|colored|rgb|image|img|im|view|texture|vis|viz|overlay|intensity|fixed|moving"
)
_OTHER_STEMS = ("left", "{scene}_left")


@dataclass(frozen=True)
class MapOptions:
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
        return file if self._in_run_folder(path) and os.path.isfile(file) else None

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
        files = sorted(inside.glob("disp0*.pfm"))
        kit = sorted(path for path in files if not path.stem.startswith("disp0GT"))
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
    if not os.path.isdir(folder):  # in an archive
        below = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("[!.]*") if os.path.isfile(path))
        yield from (path for path in below if path.lower().endswith(tuple(suffixes)))
        return
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
