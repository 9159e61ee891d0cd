"""A scene as the page shows it: its maps packed for the script, and small pictures for readers without one.

A scene with ground truth shows the maps of several runs and their errors; one without shows the map of one run, with
what the run says of it.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.text import side_and_distance
from depthcli.evaluation.protocols import UNKNOWN, AnyProtocol, ShownMap, SliceAxis, pixel_kinds, shown_pixels
from depthcli.io.formats.images import read_image
from depthcli.io.formats.pictures import Palette, confidence_picture, read_status, status_color, status_words
from depthcli.io.scenes import Scene
from depthcli.report import packing
from depthcli.report.packing import Slice, pack, pack_bytes

_CONFIDENCE_LEVELS = 4096  # of a packed confidence; noise below them would only fill the page
_MAX_THUMB = 240  # pixels of a small picture's longer side
_MARGIN = 0.5  # values up to this share of the truth's range beside it are packed, those beyond as out of range
_JPEG_QUALITY = 88  # at which artifacts are not visible beneath a map
_MAX_SHEET = 1056  # pixels, width of the preview of a volume in the page
_MAX_CONFIDENCES = 4  # with a small picture and a mean; the others are in the viewer
_QUANTILES = (1, 99)  # percent, of the values that span the colors where nothing else gives their scale

Picture = NDArray[np.uint8]


class SceneView:
    """One scene, filled run by run.

    Parameters
    ----------
    protocol : by which it is scored, or its map is shown
    known, hidden : pixels with known truth, and those of them that are occluded; of the shape of the maps
    true : the truth, of that shape; None: it is not known
    axes : of a volume
    scale : lowest and highest value of the colors
    palette : colors and words of the status maps

    Attributes
    ----------
    data : what ``viewer.js`` reads, as JSON. Of the scene: ``name``, ``protocol``, ``quantity`` and ``unit`` of its
        values, ``low`` and ``high`` of their scale, ``top`` of the errors', ``hidden`` (some pixels are occluded),
        ``words`` of the kinds of pixel, ``status`` (code -> words and color), ``opacity``, ``start`` (first view) and
        ``views``. Of a view, one per slice: ``name``, ``axis``, ``plane``, ``axes`` (of columns and rows), ``tall``
        (height of a pixel over its width), ``width``, ``height``, ``factor`` (it is thinned by), ``image`` (data URI),
        packed ``truth`` and ``region`` (1: known, 2: occluded), and ``runs``: name -> packed ``values``, ``error``,
        ``wrong``, ``status``, and ``confidence`` by measure
    thumbs : run (empty: the scene itself) -> what a small picture shows -> data URI
    figures, note : without truth: heading with unit -> number, by which scenes are ordered, and their explanation
    mean_confidence : without truth: heading -> mean of a confidence map
    legend : without truth: words -> CSS color of the statuses in the small picture
    sheet : data URI of a volume's preview, instead of small pictures; or None
    """

    def __init__(
        self,
        scene: Scene,
        protocol: AnyProtocol,
        known: NDArray[np.bool_],
        hidden: NDArray[np.bool_],
        true: NDArray[Any] | None,
        axes: tuple[SliceAxis, ...],
        scale: tuple[float, float],
        palette: Palette,
    ) -> None:
        self.scene, self.protocol, self.known, self.hidden, self.palette = scene, protocol, known, hidden, palette
        self.name, shown, (low, high) = scene.name, protocol.presentation, scale
        self.image = shown.image(scene)  # (H, W, 3) RGB or (Z, Y, X) grey levels, or None
        self.thumbs: dict[str, dict[str, str]] = {}
        self.figures: dict[str, float] = {}
        self.mean_confidence: dict[str, float] = {}
        self.legend: dict[str, str] = {}
        self.note = ""
        self.sheet: str | None = None
        # What small error pictures are drawn from, once the scale is known: run -> kinds of pixel, errors, quantile.
        self._errors: dict[str, tuple[Picture, NDArray[np.floating[Any]], float]] = {}
        self._cuts = packing.slices(known.shape)
        # The first view is of the first axis the slice with most known pixels, of such ones the most central.
        first = [number for number, cut in enumerate(self._cuts) if cut.axis == self._cuts[0].axis]
        n_known = {n: int(np.count_nonzero(known[self._cuts[n].index])) for n in first}
        middle = self._cuts[0].n_places // 2
        start = max(first, key=lambda n: (n_known[n], -abs(self._cuts[n].place - middle)))
        self._start = self._cuts[start]
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
                "image": None if picture is None else _jpeg(picture),
                "truth": None if true is None else pack(self._true(true, cut), *_with_margin(low, high)),
                "region": pack_bytes(plane + 2 * hidden[cut.index].astype(np.uint8)), "runs": {},
            })  # fmt: skip
        if self.image is not None:
            flat = self.image if self._start.axis < 0 else np.stack([self.image[self._start.index]] * 3, axis=-1)
            step = _step(flat.shape[:2])
            self.thumbs[""] = {"image": _jpeg(_shrunk(flat, flat.shape[1] // step, flat.shape[0] // step))}
        if true is not None:
            self.thumbs.setdefault("", {})["truth"] = self._map_thumb(self._true(true, self._start))

    def _true(self, true: NDArray[Any], cut: Slice) -> NDArray[Any]:
        return np.where(self.known[cut.index], true[cut.index], np.nan)

    def add(
        self,
        run: str,
        path: Path,
        estimate: Any,
        truth: Any,
        confidences: Mapping[str, NDArray[Any]],
        dense: ShownMap | None = None,
    ) -> None:
        """Add one run's map, with the status and confidence maps beside it; ``dense``: shown instead of few points."""
        protocol, known, cut = self.protocol, self.known, self._start.index
        on_grid: Any = protocol.presentation.on_grid
        error = np.where(known, on_grid(protocol.error(estimate, truth), truth), np.nan)
        wrong = on_grid(protocol.wrong(estimate, truth), truth) & known
        values, true = (on_grid(each, truth) for each in (protocol.values(estimate, truth), truth.values))
        planes: dict[str, Any] = {name: on_grid(plane, truth) for name, plane in confidences.items()}
        packed_range = _with_margin(self.data["low"], self.data["high"])
        if dense is not None and dense.values.shape == known.shape:
            values, planes, packed_range = dense.values, dense.confidence, range_of(dense.values)
        # The script takes the difference of values and truth where that is the error.
        is_difference = np.allclose(error[known], np.abs(values - true)[known], rtol=1e-4, atol=1e-4, equal_nan=True)
        packed_error = None if is_difference else (error, range_of(error)[1])
        self._pack(run, (values, packed_range), packed_error, wrong, self._status(path), planes)
        kind = pixel_kinds(known[cut], self.hidden[cut], wrong[cut], np.isnan(error[cut]))
        worst = error[wrong & ~np.isnan(error)]
        high = float(np.quantile(worst, 0.9)) if worst.size else math.nan
        self._errors[run] = (_small(kind), _small(error[cut]), high)
        self.thumbs.setdefault(run, {})["map"] = self._map_thumb(values[cut])

    def add_shown(self, run: str, path: Path, shown: ShownMap) -> None:
        """Add the map of a run without truth: map, status, confidence and expected error."""
        status, error = self._status(path), shown.expected_error
        words, cut = self.protocol.presentation, self._start.index
        top = self.data["top"] = 1.0 if error is None else float(f"{scale_of(error)[1]:.2g}")
        confidence = {n: plane for n, plane in shown.confidence.items() if plane.shape == shown.values.shape}
        packed_error = None if error is None else (error, top)
        self._pack(run, (shown.values, range_of(shown.values)), packed_error, None, status, confidence)
        for view in self.data["views"]:
            view["region"] = None
        self.figures, self.note = dict(shown.figures), shown.note
        chosen = {
            "confidence" if name == "confidence" else f"confidence {name}": plane
            for name, plane in list(confidence.items())[:_MAX_CONFIDENCES]
        }
        for said, plane in chosen.items():
            finite = plane[np.isfinite(plane)]
            self.mean_confidence[f"{said}, mean"] = float(finite.mean()) if finite.size else np.nan
        if shown.axes and (preview := _preview(path.with_name("preview.png"))):  # three slices say more than one
            self.sheet, self.thumbs = preview, {}
            return
        low, high = (f"{float(f'{self.data[end]:.4g}'):g}" for end in ("low", "high"))
        thumbs = {f"{words.quantity}, {low} to {high} {words.unit}": self._map_thumb(shown.values[cut])}
        if error is not None:
            picture = packing.map_picture(_small(error[cut]), 0.0, top)
            thumbs[f"expected error, 0 to {top:g} {words.unit}"] = _png(picture)
        if status is not None:
            table = np.full((256, 3), packing.NO_VALUE, np.uint8)
            for value, entry in self.data["status"].items():
                table[int(value)] = entry["color"]
                color = "rgb({},{},{})".format(*entry["color"])
                if color not in self.legend.values():
                    self.legend[entry["words"].removesuffix(", smoothed")] = color
            thumbs["status"] = _png(table[_small(status[cut])])
        for said, plane in chosen.items():
            grey = confidence_picture(_small(plane[cut]))
            thumbs[f"{said}, dark: unsure"] = _png(np.repeat(grey[..., None], 3, axis=2))
        self.thumbs[run] = thumbs

    def close(self) -> None:
        """Scale the errors by the median of the runs' 90 % quantiles over wrong pixels, and draw their pictures."""
        if self._errors or "top" not in self.data:
            highs = [high for _, _, high in self._errors.values() if not math.isnan(high)]
            self.data["top"] = float(f"{float(np.median(highs)) if highs else 1.0:.2g}") or 1.0
        for run, (kind, error, _) in self._errors.items():
            shaded = packing.error_scales()[kind, packing.step_of(error, 0.0, self.data["top"], 64)]
            self.thumbs.setdefault(run, {})["error"] = self._blended(shaded, kind == UNKNOWN)
        self._errors, self.image = {}, None

    def _pack(
        self,
        run: str,
        values: tuple[NDArray[Any], tuple[float, float]],
        error: tuple[NDArray[Any], float] | None,
        wrong: NDArray[np.bool_] | None,
        status: Picture | None,
        confidence: Mapping[str, NDArray[Any]],
    ) -> None:
        """Pack the maps of a run, cut by cut; ``values`` and ``error`` with the range, or top, that is packed."""
        for view, cut in zip(self.data["views"], (each.index for each in self._cuts), strict=True):
            planes = {}
            for name, plane in confidence.items():
                numbers = plane[cut].astype(np.float64)
                finite = numbers[np.isfinite(numbers)]
                shown = np.percentile(finite, _QUANTILES).tolist() if finite.size else [0.0, 1.0]
                planes[name] = {**pack(numbers, *range_of(numbers), _CONFIDENCE_LEVELS), "shown": shown}
            view["runs"][run] = {
                "values": pack(values[0][cut], *values[1]),
                "error": None if error is None else pack(error[0][cut], 0.0, error[1]),
                "wrong": None if wrong is None else pack_bytes(wrong[cut]),
                "status": None if status is None else pack_bytes(status[cut]),
                "confidence": planes,
            }

    def _map_thumb(self, plane: NDArray[np.floating[Any]]) -> str:
        small = _small(plane)
        return self._blended(packing.map_picture(small, self.data["low"], self.data["high"]), np.isnan(small))

    def _blended(self, small: Picture, nothing: NDArray[np.bool_]) -> str:
        """Return a small picture over the image of the first cut, which is alone at ``nothing``."""
        image, opacity = self._image_of(self._start), self.protocol.presentation.opacity
        if image is not None and opacity < 1:
            beneath = _small(image)
            mixed = np.rint(opacity * small + (1 - opacity) * beneath).astype(np.uint8)
            small = np.where(nothing[..., None], beneath, mixed)
        return _png(small)

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
        except InputError:  # the map counts, the status beside it is an extra
            return None
        if status is None or status.shape != self.known.shape:
            return None
        for value in np.unique(status).tolist():
            words, color = status_words(value, self.palette), status_color(value, self.palette)
            self.data["status"][str(value)] = {"words": words, "color": color}
        return status


def view_with_truth(protocol: AnyProtocol, scene: Scene, truth: Any) -> SceneView | None:
    """Return the view of a scene without runs; None if its points lie on no grid."""
    shown = protocol.presentation
    known, hidden = (shown.on_grid(pixels, truth) for pixels in shown_pixels(protocol, truth))
    if known is None or hidden is None:
        return None
    true = shown.on_grid(truth.values, truth)
    scale = range_of(None if true is None else true[known])
    return SceneView(scene, protocol, known, hidden, true, shown.axes(truth), scale, shown.palette)


def smaller(data: dict[str, Any], factor: int) -> dict[str, Any]:
    """Return a scene's data with every ``factor``-th pixel."""
    views = []
    for view in data["views"]:
        height, width = (-(-view[side] // factor) for side in ("height", "width"))
        views.append(packing.thinned(view, factor) | {"height": height, "width": width, "factor": factor})
        if view["image"] is not None:
            code = np.frombuffer(base64.b64decode(view["image"].partition(",")[2]), np.uint8)
            picture = cv2.imdecode(code, cv2.IMREAD_COLOR)
            assert picture is not None  # it was written here
            views[-1]["image"] = _jpeg(np.asarray(cv2.resize(picture, (width, height))[..., ::-1], np.uint8))
    return {**data, "views": views}


def _with_margin(low: float, high: float) -> tuple[float, float]:
    return low - _MARGIN * (high - low), high + _MARGIN * (high - low)


def range_of(values: NDArray[np.floating[Any]] | None) -> tuple[float, float]:
    """Return the lowest and highest finite value, never the same; (0, 1) if there is none."""
    finite = np.array([]) if values is None else values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    return low, max(high, low + 1e-3)


def scale_of(values: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Return quantiles of the finite values, never the same; (0, 1) if there is none."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, _QUANTILES).tolist() if finite.size else (0.0, 1.0)
    return low, max(high, low + 1e-3)


def _step(shape: tuple[int, ...]) -> int:
    return max(1, -(-max(shape[:2]) // _MAX_THUMB))


def _small(plane: NDArray[Any]) -> NDArray[Any]:
    step = _step(plane.shape)
    return plane[::step, ::step]


def _shrunk(picture: Picture, width: int, height: int) -> Picture:
    shape = max(1, width), max(1, height)
    return np.asarray(cv2.resize(picture, shape, interpolation=cv2.INTER_AREA), np.uint8)


def _preview(file: Path) -> str | None:
    """Return the preview of a volume as a JPEG of the page's width; None if it was not kept."""
    try:
        picture = np.asarray(read_image(file), np.uint8)
    except InputError:
        return None
    height, width = picture.shape[:2]
    share = min(1.0, _MAX_SHEET / width)
    return _jpeg(_shrunk(picture, min(width, _MAX_SHEET), round(height * share)))


def _jpeg(picture: Picture) -> str:
    code = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    return f"data:image/jpeg;base64,{base64.b64encode(code.tobytes()).decode('ascii')}"


def _png(picture: Picture) -> str:
    code = cv2.imencode(".png", picture[..., ::-1])[1]
    return f"data:image/png;base64,{base64.b64encode(code.tobytes()).decode('ascii')}"
