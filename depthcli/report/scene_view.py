"""A scene as the page shows it: its maps packed for the script, and small pictures for readers without one.

A scene with ground truth shows the maps of several runs and their errors; one without shows the map of one run, with
the run's own figures of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.text import side_and_distance
from depthcli.evaluation.map_files import PROBABILITY
from depthcli.evaluation.protocols import (
    UNKNOWN,
    AnyProtocol,
    ShownMap,
    SliceAxis,
    error_scales,
    pixel_kinds,
    shown_pixels,
)
from depthcli.io.formats.images import read_image
from depthcli.io.formats.pictures import (
    NO_VALUE,
    Palette,
    bound_picture,
    bound_range,
    confidence_picture,
    map_picture,
    read_status,
    status_color,
    status_words,
    step_of,
)
from depthcli.io.scenes import Scene
from depthcli.report.packing import PackedScene, jpeg, pack, pack_bytes, png

_CONFIDENCE_LEVELS = 4096  # of a packed confidence; noise below them would only fill the page
_MAX_THUMB = 240  # pixels of a small picture's longer side
_MARGIN = 0.5  # values up to this share of the truth's range outside it are packed, others as out of range
_MAX_PICTURE = 480  # pixels, width of a picture among the small ones whose text can be read
_MAX_SHEET = 1240  # pixels, width of the preview of a volume in the page
_MAX_CONFIDENCES = 4  # with a small picture and a mean; the others are in the viewer
_QUANTILES = (1, 99)  # percent, of the values that span the colors where nothing else gives their scale
_MAX_PIXELS = 3_000_000  # of all slices of a volume that are shown, which keeps its pictures near 10 MB per run

_EXPECTED_WRONG = "expected wrong: mean probability of an error above the run's limit (--within)"

Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Range = tuple[float, float]


@dataclass(frozen=True)
class Slice:
    """A plane of an array that is shown, ``array[index]``: an image itself, or a slice of a volume."""

    axis: int  # that it is perpendicular to, -1 for an image itself
    place: int  # number of the slice along that axis, from 0
    n_places: int
    index: tuple[Any, ...]


def slices(shape: tuple[int, ...], max_pixels: int = _MAX_PIXELS) -> list[Slice]:
    """Return the planes that are shown: an image itself; of a volume (Z, Y, X) slices across every axis.

    The middle slices are among them. If a volume has more than about ``max_pixels`` in all of them together, every
    second, third ... slice is taken.
    """
    if len(shape) == 2:
        return [Slice(-1, 0, 1, (...,))]
    sides = [shape[:axis] + shape[axis + 1 :] for axis in range(3)]
    axes = [axis for axis in range(3) if min(sides[axis]) > 1] or [0]  # an image of one slice has no others
    step = max(1, math.ceil(len(axes) * math.prod(shape) / max_pixels))
    made = []
    for axis in axes:
        for place in range(shape[axis] // 2 % step, shape[axis], step):
            index = tuple(place if other == axis else slice(None) for other in range(3))
            made.append(Slice(axis, place, shape[axis], index))
    return made


class _Errors(NamedTuple):
    """Data of the small picture of a run's errors, which is drawn once their scale is known."""

    kind: Picture  # of pixel
    error: NDArray[np.floating[Any]]
    high: float  # 90 % quantile over wrong pixels, NaN: there are none


class ShownTruth(NamedTuple):
    """What is known of a scene, in the shape of its maps, and the scale of their colors."""

    known: Mask  # pixels with known truth
    hidden: Mask  # the occluded ones among them
    values: NDArray[Any] | None  # NaN where the truth is not known; None: everywhere
    axes: tuple[SliceAxis, ...]  # of a volume
    scale: Range  # lowest and highest value of the colors


class SceneView:
    """One scene, filled run by run.

    Parameters
    ----------
    protocol : by which it is scored, or its map is shown
    palette : colors and words of the status maps; None: the protocol's

    Attributes
    ----------
    data : what ``viewer.js`` reads, as JSON. Of the scene: ``name``, ``protocol``, ``quantity`` and ``unit`` of its
        values, ``low`` and ``high`` of their scale, ``top`` of the errors', ``bound`` (ends of the bounds', or None),
        ``hidden`` (some pixels are occluded), ``words`` of the kinds of pixel, ``status`` (code -> words and color),
        ``opacity``, ``start`` (first view) and ``views``. Of a view, one per slice: ``name``, ``axis``, ``plane``,
        ``axes`` (of columns and rows), ``tall`` (height of a pixel over its width), ``width``, ``height``, ``factor``
        (it is thinned by), ``image`` (data URI), packed ``sensor``, ``truth`` and ``region`` (1: known, 2: occluded),
        and ``runs``: name -> packed ``values``, ``error``, ``wrong``, ``bound``, ``status``, ``confidence`` by measure
    thumbs : run (empty: the scene itself) -> title of a small picture -> data URI
    above : prefix of the figures: empty, or "> " where they are lower bounds
    figures, note : without truth: heading with unit -> number, by which scenes are ordered, and their explanation
    mean_confidence : without truth: heading -> mean of a confidence map
    legend : without truth: words -> CSS color of the statuses in the small picture
    sheet : data URI of a volume's preview, instead of small pictures; or None
    scale, top : words for the ends of the values' scale, and for the upper one of the errors'; empty: no errors
    bound : ends of the bounds' scale; None: there are none
    packed : the data in a file, where they are once the view is closed
    """

    def __init__(self, scene: Scene, protocol: AnyProtocol, truth: ShownTruth, palette: Palette | None = None) -> None:
        known, hidden, true, axes, (low, high) = truth
        self.scene, self.protocol, self.known, self.hidden = scene, protocol, known, hidden
        self.name, shown = scene.name, protocol.presentation
        self.palette = shown.palette if palette is None else palette
        self.image = shown.image(scene)  # (H, W, 3) RGB or (Z, Y, X) grey levels, or None
        sensor = shown.sensor(scene)  # a map of the scene's shape, or None
        sensor = None if sensor is None or sensor.shape != known.shape else sensor
        self.thumbs: dict[str, dict[str, str]] = {}
        self.figures: dict[str, float] = {}
        self.mean_confidence: dict[str, float] = {}
        self.legend: dict[str, str] = {}
        self.note = self.above = ""
        self.sheet: str | None = None
        self.packed: PackedScene
        self.bound: Range | None = None
        self._errors: dict[str, _Errors] = {}
        self._bounds: dict[str, NDArray[np.floating[Any]]] = {}  # run -> small one, drawn once their scale is known
        self._cuts = slices(known.shape)
        # The first view is of the first axis the slice with most known pixels, of such ones the most central.
        first = [number for number, cut in enumerate(self._cuts) if cut.axis == self._cuts[0].axis]
        n_known = {n: int(np.count_nonzero(known[self._cuts[n].index])) for n in first}
        middle = self._cuts[0].n_places // 2
        start = max(first, key=lambda n: (n_known[n], -abs(self._cuts[n].place - middle)))
        self._start = self._cuts[start]
        self.scale, self.top = (f"{low:.4g}", f"{high:.4g}"), ""
        self.data: dict[str, Any] = {
            "name": self.name, "protocol": protocol.name, "quantity": shown.quantity, "unit": shown.unit, "low": low,
            "high": high, "hidden": bool(hidden.any()), "status": {}, "views": [], "words": shown.pixel_kind_names,
            "opacity": shown.opacity, "start": start,
        }  # fmt: skip
        for cut in self._cuts:
            plane = known[cut.index]
            name = plane_name = ""
            rows, columns = [axis for k, axis in enumerate(axes) if k != cut.axis] or (None, None)
            if cut.axis >= 0:
                plane_name, name = f"axis {cut.axis}", f"{cut.place + 1} of {cut.n_places}"
            if axes:
                axis = axes[cut.axis]
                place = side_and_distance(axis.ends, axis.first + axis.step * cut.place)
                plane_name, name = axis.plane, f"{axis.plane}, {place}, {name}"
            picture = self._image_of(cut)
            self.data["views"].append({
                "name": name, "axis": cut.axis, "plane": plane_name, "axes": [columns, rows],
                "tall": abs(rows.step / columns.step) if rows and columns else 1.0,
                "width": plane.shape[1], "height": plane.shape[0], "factor": 1,
                "image": None if picture is None else jpeg(picture),
                "sensor": None if sensor is None else pack(sensor[cut.index], *range_of(sensor)),
                "truth": None if true is None else pack(true[cut.index], *_with_margin(low, high)),
                "region": pack_bytes(plane + 2 * hidden[cut.index].astype(np.uint8)), "runs": {},
            })  # fmt: skip
        if self.image is not None:
            flat = self.image if self._start.axis < 0 else np.stack([self.image[self._start.index]] * 3, axis=-1)
            step = _step(flat.shape[:2])
            self.thumbs[""] = {"image": jpeg(_shrunk(flat, flat.shape[1] // step, flat.shape[0] // step))}
        for kind, plane in (("sensor", sensor), ("truth", true)):
            if plane is not None:
                self.thumbs.setdefault("", {})[kind] = self._map_thumb(plane[self._start.index])

    def add(
        self,
        run: str,
        path: Path,
        estimate: Any,
        truth: Any,
        confidences: Mapping[str, NDArray[Any]],
        dense: ShownMap | None = None,
        bound: NDArray[Any] | None = None,
    ) -> None:
        """Add one run's map, with its status, confidences and bound; ``dense``: shown instead of few points."""
        protocol, known, cut = self.protocol, self.known, self._start.index
        on_grid: Any = protocol.presentation.on_grid
        error = np.where(known, on_grid(protocol.error(estimate, truth), truth), np.nan)
        wrong = on_grid(protocol.wrong(estimate, truth), truth) & known
        values, true = (on_grid(each, truth) for each in (protocol.values(estimate, truth), truth.values))
        planes: dict[str, Any] = {name: on_grid(plane, truth) for name, plane in confidences.items()}
        limits = _with_margin(self.data["low"], self.data["high"])
        if dense is not None and dense.values.shape == known.shape:
            values, planes, limits = dense.values, dense.confidence, range_of(dense.values)
            bound = dense.bound
        elif bound is not None:
            bound = on_grid(protocol.map_unit * bound.astype(np.float64), truth)
        # The script takes the difference of values and truth where that is the error.
        is_difference = np.allclose(error[known], np.abs(values - true)[known], rtol=1e-4, atol=1e-4, equal_nan=True)
        shown, stored = ShownMap(values, planes, bound), None if is_difference else error
        self._pack(run, shown, limits, self._status(path), stored, wrong)
        kind = pixel_kinds(known[cut], self.hidden[cut], wrong[cut], np.isnan(error[cut]))
        worst = error[wrong & ~np.isnan(error)]
        high = float(np.quantile(worst, 0.9)) if worst.size else math.nan
        self._errors[run] = _Errors(_small(kind), _small(error[cut]), high)
        self.thumbs.setdefault(run, {})["map"] = self._map_thumb(values[cut])

    def add_picture(self, run: str, kind: str, file: Path) -> None:
        """Add a picture of a run's map that is a file, if it can be read."""
        if (picture := _preview(file, _MAX_PICTURE)) is not None:
            self.thumbs.setdefault(run, {})[kind] = picture

    def add_shown(self, run: str, path: Path, shown: ShownMap) -> None:
        """Add the map of a run without truth: map, status, confidences and bound."""
        status, words, cut = self._status(path), self.protocol.presentation, self._start.index
        known = np.isfinite(shown.values)
        confidence = {n: plane for n, plane in shown.confidence.items() if plane.shape == known.shape}
        self._pack(run, replace(shown, confidence=confidence), range_of(shown.values), status)
        for view in self.data["views"]:
            view["region"] = None
        self.note = shown.note
        if PROBABILITY in confidence and known.any():
            self.figures["expected wrong, %"] = 100 * (1 - float(confidence[PROBABILITY][known].mean()))
            self.note = "; ".join(filter(None, (_EXPECTED_WRONG, self.note)))
        self.figures |= shown.figures
        titles = {"confidence": "confidence", PROBABILITY: "probability"}
        chosen = {titles.get(n, f"confidence {n}"): plane for n, plane in [*confidence.items()][:_MAX_CONFIDENCES]}
        for said, plane in chosen.items():
            finite = plane[np.isfinite(plane)]
            self.mean_confidence[f"{said}, mean"] = float(finite.mean()) if finite.size else np.nan
        self.mean_confidence.pop("probability, mean", None)  # the figure "expected wrong" shows it
        if shown.axes and (preview := _preview(path.with_name("preview.png"))):  # three slices show more than one
            self.sheet, self.thumbs = preview, {}
            return
        low, high = (_significant(self.data[end], 4) for end in ("low", "high"))
        thumbs = {f"{words.quantity}, {low:g} to {high:g} {words.unit}": self._map_thumb(shown.values[cut])}
        if status is not None:
            table = np.full((256, 3), NO_VALUE, np.uint8)
            for value, entry in self.data["status"].items():
                table[int(value)] = entry["color"]
                color = "rgb({},{},{})".format(*entry["color"])
                if color not in self.legend.values():
                    self.legend[entry["words"].removesuffix(", smoothed")] = color
            thumbs["status"] = png(table[_small(status[cut])])
        for said, plane in chosen.items():
            grey = confidence_picture(_small(plane[cut]))
            thumbs[f"{said}, dark: unsure"] = png(np.repeat(grey[..., None], 3, axis=2))
        self.thumbs[run] = thumbs

    def close(self, file: Path) -> None:
        """Draw the pictures of errors, and move the data from memory to ``file``.

        The scale of the errors ends at the median of the runs' 90 % quantiles over wrong pixels.
        """
        highs = [each.high for each in self._errors.values() if not math.isnan(each.high)]
        self.data["top"] = _significant(float(np.median(highs)) if highs else 1.0, 2) or 1.0
        self.top = f"{self.data['top']:g}" if self._errors else ""
        for run, thumbs in self.thumbs.items():
            first = dict([*thumbs.items()][:1])
            if run in self._errors:
                kind, error, _ = self._errors[run]
                shaded = error_scales()[kind, step_of(error, 0.0, self.data["top"], 64)]
                first["error"] = self._blended(shaded, kind == UNKNOWN)
            if run in self._bounds and self.bound is not None:
                first["bound"] = png(bound_picture(self._bounds[run], *self.bound))
            self.thumbs[run] = {**first, **thumbs}
        self.packed = PackedScene.write(file, self.data | {"bound": self.bound})
        self._errors, self._bounds, self.image, self.data = {}, {}, None, {}

    def _pack(
        self,
        run: str,
        shown: ShownMap,
        limits: Range,
        status: Picture | None,
        error: NDArray[np.floating[Any]] | None = None,
        wrong: Mask | None = None,
    ) -> None:
        """Pack the maps of a run, cut by cut: values between ``limits``; without truth there is no ``wrong``."""
        bound, top, wide = shown.bound, range_of(error)[1], 0.0
        if bound is not None and bound.shape != self.known.shape:
            bound = None
        if bound is not None:
            low, wide = bound_range(bound)
            self.bound = (low, wide) if self.bound is None else (min(low, self.bound[0]), max(wide, self.bound[1]))
            self._bounds[run] = _small(bound[self._start.index])
        for view, cut in zip(self.data["views"], (each.index for each in self._cuts), strict=True):
            planes = {}
            for name, plane in shown.confidence.items():
                numbers = plane[cut].astype(np.float64)
                finite = numbers[np.isfinite(numbers)]
                ends = np.percentile(finite, _QUANTILES).tolist() if finite.size else [0.0, 1.0]
                planes[name] = {**pack(numbers, *range_of(numbers), _CONFIDENCE_LEVELS), "shown": ends}
            view["runs"][run] = {
                "values": pack(shown.values[cut], *limits),
                "error": None if error is None else pack(error[cut], 0.0, top),
                "wrong": None if wrong is None else pack_bytes(wrong[cut]),
                "bound": None if bound is None else pack(bound[cut], 0.0, wide, _CONFIDENCE_LEVELS),
                "status": None if status is None else pack_bytes(status[cut]),
                "confidence": planes,
            }

    def _map_thumb(self, plane: NDArray[np.floating[Any]]) -> str:
        small = _small(plane)
        return self._blended(map_picture(small, self.data["low"], self.data["high"]), np.isnan(small))

    def _blended(self, small: Picture, nothing: Mask) -> str:
        """Return a small picture over the image of the first cut, which is alone at ``nothing``."""
        image, opacity = self._image_of(self._start), self.protocol.presentation.opacity
        if image is not None and opacity < 1:
            beneath = _small(image)
            mixed = np.rint(opacity * small + (1 - opacity) * beneath).astype(np.uint8)
            small = np.where(nothing[..., None], beneath, mixed)
        return png(small)

    def _image_of(self, cut: Slice) -> Picture | None:
        """Return the (H, W, 3) RGB image beneath a cut of the maps, at their size; None if its shape does not fit."""
        shape = self.known.shape
        if self.image is None:
            return None
        if cut.axis >= 0:
            return np.stack([self.image[cut.index]] * 3, axis=-1) if self.image.shape == shape else None
        height, width = self.image.shape[:2]
        if abs(width * shape[0] - height * shape[1]) > 2 * max(width, height):
            return None
        return self.image if (height, width) == shape else np.asarray(cv2.resize(self.image, shape[::-1]), np.uint8)

    def _status(self, path: Path) -> Picture | None:
        file = self.protocol.files.status(path) if self.palette else None
        try:
            status = None if file is None else read_status(file)
        except InputError:  # the map counts, its status is an extra
            return None
        if status is None or status.shape != self.known.shape:
            return None
        for value in np.unique(status).tolist():
            words, color = status_words(value, self.palette), status_color(value, self.palette)
            self.data["status"][str(value)] = {"words": words, "color": color}
        return status


def view_with_truth(protocol: AnyProtocol, scene: Scene, truth: Any) -> SceneView | None:
    """Return the view of a scene without runs; None if its points are on no grid."""
    shown = protocol.presentation
    known, hidden = (shown.on_grid(pixels, truth) for pixels in shown_pixels(protocol, truth))
    if known is None or hidden is None:
        return None
    true = shown.on_grid(truth.values, truth)
    scale = range_of(None if true is None else true[known])
    true = None if true is None else np.where(known, true, np.nan)
    return SceneView(scene, protocol, ShownTruth(known, hidden, true, shown.axes(truth), scale))


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
    """Return quantiles of the finite values, never the same; (0, 1) if there is none."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, _QUANTILES).tolist() if finite.size else (0.0, 1.0)
    return low, max(high, low + 1e-3)


def _significant(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def _step(shape: tuple[int, ...]) -> int:
    return max(1, -(-max(shape[:2]) // _MAX_THUMB))


def _small(plane: NDArray[Any]) -> NDArray[Any]:
    step = _step(plane.shape)
    return plane[::step, ::step]


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
