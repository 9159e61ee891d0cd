"""Where the maps of a run lie: which file is scored for a scene, and which files beside it belong to it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.data.formats.disparity import MAP_SUFFIXES


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

    def candidates(self, folder: Path, scene: str) -> Iterator[Path]:
        """Yield the paths that the map of a scene may have, in order of preference; they need not exist."""
        for place in self.places:
            for suffix in self.suffixes:
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
        places = ", ".join([*(f"{place}.*" for place in self.places), *self.other_places]).replace("{scene}", "SCENE")
        short = names[0].rpartition("/")[2]
        several = "" if short in names else f"; several scenes are called {short}, so that the name needs its folder"
        return f" (looked for {places}{several})"

    def confidences(self, path: Path) -> dict[str, Path]:
        """Return name -> file of the confidence maps beside a map: ``confidence_<name>.pfm`` or ``.npy``."""
        if not self._in_run_folder(path):
            return {}
        files = sorted(p for p in path.parent.glob("confidence_*") if p.suffix.lower() in (".pfm", ".npy"))
        return {file.stem.removeprefix("confidence_"): file for file in files}

    def status(self, path: Path) -> Path | None:
        """Return the status map beside a map; None where there is none."""
        file = path.parent / "status.png"
        return file if self._in_run_folder(path) and os.path.isfile(file) else None

    def _in_run_folder(self, path: Path) -> bool:
        """True where the map is named as in a run folder, so that the files beside it belong to it."""
        return any(place.rpartition("/")[2] == path.stem for place in self.places)


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
        files = inside.glob("disp0*.pfm") if os.path.isdir(inside) else ()
        kit = sorted(path for path in files if not path.stem.startswith("disp0GT"))
        dense = [path for path in kit if not path.stem.endswith("_s")] or kit
        named = [path for path in dense if path.stem == f"disp0{folder.resolve().name}"] or dense
        if len(named) > 1:
            raise InputError(f"{inside}: both {named[0].name} and {named[1].name}; keep one method in a folder")
        yield from named
