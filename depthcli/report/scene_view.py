"""A scene on the page: its maps packed for the script, and small pictures for readers without scripts.

A scene with ground truth shows the maps of several runs and their errors. A scene without ground truth shows the map of
one run, with the run's own figures.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.text import side_and_distance
from depthcli.evaluation.evaluate import ScoredMap
from depthcli.evaluation.map_files import PROBABILITY
from depthcli.evaluation.protocols import AnyProtocol, ShownMap, shown_pixels
from depthcli.io.formats.disparity import read_status
from depthcli.io.formats.images import read_image
from depthcli.io.scenes import Scene
from depthcli.report.packing import PackedScene, jpeg, pack, pack_bytes, png
from depthcli.show.view import (
    HIDDEN_RIGHT,
    Palette,
    Picture,
    Range,
    View,
    bound_range,
    draw,
    pixel_kinds,
    spread,
    status_colors,
    status_words,
)

_CONFIDENCE_LEVELS = 4096  # of a packed confidence; noise below them would only fill the page
_MAX_THUMB = 240  # pixels of a small picture's longer side
_MARGIN = 0.5  # values up to this share of the truth's range outside it are packed, others as out of range
_MAX_PICTURE = 480  # pixels, width of a picture among the small ones whose text can be read
_MAX_SHEET = 1240  # pixels, width of the preview of a volume in the page
_MAX_CONFIDENCES = 4  # with a small picture and a mean; the others are in the viewer
_MAX_PIXELS = 3_000_000  # of all slices of a volume that are shown, which keeps its pictures near 10 MB per run

_EXPECTED_WRONG = "expected incorrect: mean probability of an error above the run's limit (--within)"

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Slice:
    """A plane ``array[index]`` of a shown array: an image itself, or a slice of a volume."""

    axis: int  # that it is perpendicular to, -1 for an image itself
    place: int  # number of the slice along that axis, from 0
    n_places: int
    index: tuple[Any, ...]


def slices(shape: tuple[int, ...], max_pixels: int = _MAX_PIXELS) -> list[Slice]:
    """Return the shown planes: an image itself, or slices of a volume (Z, Y, X) across every axis.

    They include the middle slices. If all slices together have more than about ``max_pixels``, every second, third ...
    slice is taken.
    """
    if len(shape) == 2:
        return [Slice(-1, 0, 1, (...,))]
    sides = [shape[:axis] + shape[axis + 1 :] for axis in range(3)]
    axes = [axis for axis in range(3) if min(sides[axis]) > 1] or [0]  # an image of one slice has no others
    step = max(1, math.ceil(len(axes) * math.prod(shape) / max_pixels))
    planes = []
    for axis in axes:
        for place in range(shape[axis] // 2 % step, shape[axis], step):
            index = tuple(place if other == axis else slice(None) for other in range(3))
            planes.append(Slice(axis, place, shape[axis], index))
    return planes


class SceneView:
    """One scene, filled run by run.

    Parameters
    ----------
    protocol : the protocol that scores or shows the scene
    palette : colors and words of the status maps; None: the protocol's

    Attributes
    ----------
    data : the JSON data for ``viewer.js``. Of the scene: ``name``, ``protocol``, ``quantity`` and ``unit`` of its
        values, ``low`` and ``high`` of their scale, ``top`` of the errors', ``bound`` (ends of the bounds', or None),
        ``hidden`` (some pixels are occluded), ``words`` of the kinds of pixel, ``status`` (code -> words and color),
        ``opacity``, ``start`` (first view) and ``views``. Of a view, one per slice: ``name``, ``axis``, ``plane``,
        ``axes`` (of columns and rows), ``tall`` (height of a pixel over its width), ``width``, ``height``, ``factor``
        (it is thinned by), ``image`` (data URI), packed ``sensor``, ``truth`` and ``region`` (1: known, 2: occluded),
        and ``runs``: name -> packed ``values``, ``error``, ``wrong``, ``bound``, ``status``, ``confidence`` by measure
    thumbs : run (empty: the scene itself) -> title of a small picture -> data URI
    above : prefix of the figures: empty, or "> " if they are lower bounds
    figures, note : without ground truth: heading with unit -> number, which orders the scenes; and an explanation
    mean_confidence : without truth: heading -> mean of a confidence map
    legend : without truth: words -> CSS color of the statuses in the small picture
    codes : of the status maps
    sheet : data URI of a volume's preview, instead of small pictures; or None
    scale, top : words for the ends of the values' scale, and for the upper one of the errors'; empty: no errors
    bound : ends of the bounds' scale; None: there are none
    packed : the data, in a file after the view is closed
    """

    def __init__(self, scene: Scene, protocol: AnyProtocol, base: View, palette: Palette | None = None) -> None:
        self.scene, self.protocol, self.base = scene, protocol, base
        self.name, words, (low, high) = scene.name, protocol.presentation, base.scale
        self.palette = words.palette if palette is None else palette
        self.image = words.image(scene)  # (H, W, 3) RGB or (Z, Y, X) grey levels, or None
        self.thumbs: dict[str, dict[str, str]] = {}
        self.figures: dict[str, float] = {}
        self.mean_confidence: dict[str, float] = {}
        self.legend: dict[str, str] = {}
        self.codes: set[int] = set()
        self.note = self.above = ""
        self.sheet: str | None = None
        self.packed: PackedScene
        self.scale, self.top = (f"{low:.4g}", f"{high:.4g}"), ""
        self.bound: Range | None = None
        self._drawn: dict[str, dict[str, tuple[str, View]]] = {}  # run -> title of a small picture -> of which view
        self._highs: list[float] = []  # 90 % quantiles of the errors of incorrect pixels
        self._cuts = slices(base.values.shape)
        region = np.zeros(base.values.shape, np.uint8) if base.kinds is None else base.kinds
        first = self._first_cut(region)
        self._start = self._cuts[first]
        sensor = words.sensor(scene)  # a map of the scene's shape, or None
        sensor = None if sensor is None or sensor.shape != base.values.shape else sensor
        self.data: dict[str, Any] = {
            "name": self.name, "protocol": protocol.name, "quantity": words.quantity, "unit": words.unit, "low": low,
            "high": high, "hidden": bool((region == HIDDEN_RIGHT).any()), "status": {},
            "views": [self._packed_cut(cut, region, sensor) for cut in self._cuts],
            "words": words.pixel_kind_names, "opacity": words.opacity, "start": first,
        }  # fmt: skip
        self._add_thumbs_of_scene(sensor)

    def _first_cut(self, region: NDArray[np.uint8]) -> int:
        """Return the number of the first view: of the first axis' slices, the one with most known pixels.

        Of several such slices, it is the most central one.
        """
        cuts = self._cuts
        numbers = [number for number, cut in enumerate(cuts) if cut.axis == cuts[0].axis]
        n_known = {n: int(np.count_nonzero(region[cuts[n].index])) for n in numbers}
        middle = cuts[0].n_places // 2
        return max(numbers, key=lambda n: (n_known[n], -abs(cuts[n].place - middle)))

    def _packed_cut(
        self, cut: Slice, region: NDArray[np.uint8], sensor: NDArray[np.floating[Any]] | None
    ) -> dict[str, Any]:
        """Return the data of a view: its place, the image, sensor and truth; the runs are added later."""
        plane, picture = region[cut.index], self._image_of(cut)
        true = None if self.base.kinds is None else self.base.values
        return {
            **self._place(cut), "width": plane.shape[1], "height": plane.shape[0], "factor": 1,
            "image": None if picture is None else jpeg(picture),
            "sensor": None if sensor is None else pack(sensor[cut.index], *range_of(sensor)),
            "truth": None if true is None else pack(true[cut.index], *_with_margin(*self.base.scale)),
            "region": None if true is None else pack_bytes(plane), "runs": {},
        }  # fmt: skip

    def _add_thumbs_of_scene(self, sensor: NDArray[np.floating[Any]] | None) -> None:
        """Add small pictures of the image, the sensor's map and the truth, as far as there are any."""
        if self.image is not None:
            flat = self.image if self._start.axis < 0 else np.stack([self.image[self._start.index]] * 3, axis=-1)
            height, width = flat.shape[:2]
            step = _step(width, height)
            self.thumbs[""] = {"image": jpeg(_shrunk(flat, width // step, height // step))}
        true = None if self.base.kinds is None else self.base.values
        for kind, values in (("sensor", sensor), ("truth", true)):
            if values is not None:
                self.thumbs.setdefault("", {})[kind] = png(draw(self._small(View(values)), "values"))

    def _place(self, cut: Slice) -> dict[str, Any]:
        """Return the names of a cut, of its axes, and how tall its pixels are."""
        axes = self.base.axes
        rows, columns = [axis for k, axis in enumerate(axes) if k != cut.axis] or (None, None)
        plane = f"axis {cut.axis}" if cut.axis >= 0 else ""
        name = f"{cut.place + 1} of {cut.n_places}" if cut.axis >= 0 else ""
        if axes:
            axis = axes[cut.axis]
            plane, place = axis.plane, side_and_distance(axis.ends, axis.first + axis.step * cut.place)
            name = f"{plane}, {place}, {name}"
        tall = abs(rows.step / columns.step) if rows and columns else 1.0
        return {"name": name, "axis": cut.axis, "plane": plane, "axes": [columns, rows], "tall": tall}

    def add(self, scored: ScoredMap, folder: Path) -> None:
        """Add one run's map, with its status, confidences and bound.

        ``folder`` has the picture of errors beyond the bound.
        """
        result, path, estimate, truth, confidences, bound = scored
        run, protocol, base, dense = result.run, self.protocol, self.base, None
        if protocol.presentation.at_points(truth):
            with contextlib.suppress(InputError):  # the scores count, the whole map is an extra
                dense = protocol.presentation.show(path, self.scene, protocol.files)
        assert base.kinds is not None
        known, hidden = base.kinds > 0, base.kinds == HIDDEN_RIGHT
        on_grid: Any = protocol.presentation.on_grid
        error = np.where(known, on_grid(protocol.error(estimate, truth), truth), np.nan)
        wrong = on_grid(protocol.wrong(estimate, truth), truth) & known
        values, true = (on_grid(array, truth) for array in (protocol.values(estimate, truth), truth.values))
        planes: dict[str, Any] = {name: on_grid(plane, truth) for name, plane in confidences.items()}
        limits = _with_margin(*base.scale)
        if dense is not None and dense.values.shape == known.shape:
            values, planes, bound, limits = dense.values, dict(dense.confidence), dense.bound, range_of(dense.values)
        elif bound is not None:
            bound = on_grid(protocol.map_unit * bound.astype(np.float64), truth)
        bound = bound if bound is not None and bound.shape == known.shape else None
        shown = View(values, status=self._status(path), confidence=planes, bound=bound, error=error)
        # The script takes the difference of values and truth where that is the error.
        is_difference = np.allclose(error[known], np.abs(values - true)[known], rtol=1e-4, atol=1e-4, equal_nan=True)
        self._pack(run, shown if not is_difference else replace(shown, error=None), limits, wrong)
        small = self._small(replace(shown, confidence={}, kinds=pixel_kinds(known, hidden, wrong, np.isnan(error))))
        self._drawn[run] = {"map": ("values", small), "error": ("error", small)}
        if bound is not None:
            self._drawn[run]["bound"] = "bound", small
        worst = error[wrong & ~np.isnan(error)]
        self._highs.append(float(np.quantile(worst, 0.9)) if worst.size else math.nan)
        if result.bounds and (picture := _preview(folder / result.bound_picture, _MAX_PICTURE)) is not None:
            self.thumbs[run] = {"truth outside the bound": picture}

    def add_shown(self, run: str, path: Path, shown: ShownMap) -> None:
        """Add the map of a run without ground truth: map, status, confidences and bound."""
        words, known = self.protocol.presentation, np.isfinite(shown.values)
        confidence = {n: plane for n, plane in shown.confidence.items() if plane.shape == known.shape}
        bound = shown.bound if shown.bound is not None and shown.bound.shape == known.shape else None
        status = self._status(path)
        view = View(shown.values, status=status, palette=self.palette, confidence=confidence, bound=bound)
        self._pack(run, view, range_of(shown.values))
        self.note = shown.note
        if PROBABILITY in confidence and known.any():
            self.figures["expected incorrect, %"] = 100 * (1 - float(confidence[PROBABILITY][known].mean()))
            self.note = "; ".join(filter(None, (_EXPECTED_WRONG, self.note)))
        self.figures |= shown.figures
        titles = {name: name for name in ("confidence", f"confidence_{PROBABILITY}", PROBABILITY)}
        chosen = {titles.get(name, f"confidence {name}"): name for name in [*confidence][:_MAX_CONFIDENCES]}
        for label, name in chosen.items():
            finite = confidence[name][np.isfinite(confidence[name])]
            self.mean_confidence[f"{label}, mean"] = float(finite.mean()) if finite.size else np.nan
        self.mean_confidence.pop("probability, mean", None)  # the figure "expected incorrect" shows it
        if shown.axes and (preview := _preview(path.with_name("preview.png"))):  # three slices show more than one
            self.sheet, self.thumbs = preview, {}
            return
        low, high = (_significant(end, 4) for end in self.base.scale)
        small = self._small(view)
        drawn = {f"{words.quantity}, {low:g} to {high:g} {words.unit}": ("values", small)}
        if small.bound is not None:
            drawn["bound"] = "bound", small
        if small.status is not None:
            drawn["status"] = "status", small
            for entry in self.data["status"].values():
                color = "rgb({},{},{})".format(*entry["color"])
                if color not in self.legend.values():
                    self.legend[entry["words"]] = color
        self._drawn[run] = drawn | {f"{label}, dark: unsure": (f"confidence:{n}", small) for label, n in chosen.items()}

    def close(self, file: Path) -> None:
        """Draw the pictures of the runs, and move the data from memory to ``file``.

        The scale of the errors ends at the median of the runs' 90 % quantiles over incorrect pixels.
        """
        highs = [high for high in self._highs if not math.isnan(high)]
        top = self.data["top"] = _significant(float(np.median(highs)) if highs else 1.0, 2) or 1.0
        self.top = f"{top:g}" if self._highs else ""
        scales = {"error": (0.0, top), "bound": self.bound}
        for run, drawn in self._drawn.items():
            thumbs = {title: png(draw(small, what, scales.get(what))) for title, (what, small) in drawn.items()}
            self.thumbs[run] = thumbs | self.thumbs.get(run, {})
        self.packed = PackedScene.write(file, self.data | {"bound": self.bound})
        self._drawn, self.image, self.data = {}, None, {}

    def _pack(self, run: str, view: View, limits: Range, wrong: Mask | None = None) -> None:
        """Pack the maps of a run, cut by cut: values between ``limits``; without truth there is no ``wrong``."""
        top, wide = range_of(view.error)[1], 0.0
        if view.bound is not None:
            low, wide = bound_range(view.bound)
            self.bound = (low, wide) if self.bound is None else (min(low, self.bound[0]), max(wide, self.bound[1]))
        for place, cut in zip(self.data["views"], self._cuts, strict=True):
            part, planes = view.part(cut.index), {}
            for name, plane in part.confidence.items():
                numbers = plane.astype(np.float64)
                ends = spread(numbers) if np.isfinite(numbers).any() else (0.0, 1.0)
                planes[name] = {**pack(numbers, *range_of(numbers), _CONFIDENCE_LEVELS), "shown": ends}
            place["runs"][run] = {
                "values": pack(part.values, *limits),
                "error": None if part.error is None else pack(part.error, 0.0, top),
                "wrong": None if wrong is None else pack_bytes(wrong[cut.index]),
                "bound": None if part.bound is None else pack(part.bound, 0.0, wide, _CONFIDENCE_LEVELS),
                "status": None if part.status is None else pack_bytes(part.status),
                "confidence": planes,
            }

    def _small(self, view: View) -> View:
        """Return the first cut of a view as its small pictures show it, over the image."""
        image, step = self._image_of(self._start), _step(*view.values[self._start.index].shape)
        small = view.part(self._start.index, step)
        image = None if image is None else image[::step, ::step]
        return replace(small, scale=self.base.scale, image=image, opacity=self.protocol.presentation.opacity)

    def _image_of(self, cut: Slice) -> Picture | None:
        """Return the (H, W, 3) RGB image beneath a cut of the maps, at their size; None if its shape does not fit."""
        shape = self.base.values.shape
        if self.image is None:
            return None
        if cut.axis >= 0:
            return np.stack([self.image[cut.index]] * 3, axis=-1) if self.image.shape == shape else None
        height, width = self.image.shape[:2]
        if abs(width * shape[0] - height * shape[1]) > 2 * max(width, height):
            return None
        return self.image if (height, width) == shape else np.asarray(cv2.resize(self.image, shape[::-1]), np.uint8)

    def _status(self, path: Path) -> Picture | None:
        file = self.protocol.files.companion(path, "status.png") if self.palette else None
        try:
            status = None if file is None else read_status(file)
        except InputError:  # the map counts, its status is an extra
            return None
        if status is None or status.shape != self.base.values.shape:
            return None
        for value in np.unique(status).tolist():
            words, color = status_words(value, self.palette), status_colors(self.palette)[value].tolist()
            self.codes.add(value)
            self.data["status"][str(value)] = {"words": words, "color": color}
        return status


def view_with_truth(protocol: AnyProtocol, scene: Scene, truth: Any) -> SceneView | None:
    """Return the view of a scene without runs; None if its points are on no grid."""
    words = protocol.presentation
    known, hidden = (words.on_grid(pixels, truth) for pixels in shown_pixels(protocol, truth))
    true = words.on_grid(truth.values, truth)
    if known is None or hidden is None or true is None:
        return None
    nothing = np.zeros(known.shape, np.bool_)
    kinds, scale = pixel_kinds(known, hidden, nothing, nothing), range_of(true[known])
    base = View(np.where(known, true, np.nan), words.unit, scale, axes=words.axes(truth), kinds=kinds)
    return SceneView(scene, protocol, base)


def _with_margin(low: float, high: float) -> Range:
    return low - _MARGIN * (high - low), high + _MARGIN * (high - low)


def range_of(values: NDArray[np.floating[Any]] | None) -> Range:
    """Return the lowest and highest finite value, never the same; (0, 1) if there is none."""
    finite = np.array([]) if values is None else values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    return low, max(high, low + 1e-3)


def scale_of(values: NDArray[np.floating[Any]]) -> Range:
    """Return the 1st and the 99th percentile of the finite values, never the same; (0, 1) if there is none."""
    low, high = spread(values) if np.isfinite(values).any() else (0.0, 1.0)
    return low, max(high, low + 1e-3)


def _significant(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _step(width: int, height: int) -> int:
    """Return the number of image pixels per pixel of the small picture, along each axis."""
    return max(1, -(-max(width, height) // _MAX_THUMB))


def _shrunk(picture: Picture, width: int, height: int) -> Picture:
    shape = max(1, width), max(1, height)
    return np.asarray(cv2.resize(picture, shape, interpolation=cv2.INTER_AREA), np.uint8)


def _preview(file: Path, max_width: int = _MAX_SHEET) -> str | None:
    """Return a picture, such as the preview of a volume, as a JPEG of limited width; None if it was not kept."""
    try:
        picture = np.asarray(read_image(file), np.uint8)
    except InputError:
        return None
    height, width = picture.shape[:2]
    share = min(1.0, max_width / width)
    return jpeg(_shrunk(picture, min(width, max_width), round(height * share)))
