"""A scene as the page shows it: its maps packed for the script, and small pictures for readers without one.

A scene with ground truth shows the maps of several runs and their errors; one without shows the map of one run, with
what the run says of it.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.volumes import side_and_distance
from depthcli.evaluation.protocols import UNKNOWN, AnyProtocol, ShownMap, SliceAxis, pixel_kinds, shown_pixels
from depthcli.io.formats.images import read_image
from depthcli.io.formats.pictures import Palette, confidence_picture, read_status, status_color, status_words
from depthcli.io.scenes import Scene
from depthcli.report import colors
from depthcli.report.packing import Packed, Slice, pack, pack_bytes, slices, thinned

_CONFIDENCE_LEVELS = 4096  # of a packed confidence; noise below them would only fill the page
_MAX_THUMB = 240  # pixels of a small picture's longer side
_MARGIN = 0.5  # values up to this share of the truth's range beside it are packed, those beyond as out of range
_JPEG_QUALITY = 88  # at which artifacts are not visible beneath a map
_MAX_SHEET = 1056  # pixels, width of the preview of a volume in the page
_MAX_CONFIDENCES = 4  # with a small picture and a mean; the others are in the viewer
_QUANTILES = (1, 99)  # percent, of the values that span the colors where nothing else gives their scale


@dataclass
class SceneView:
    """One scene, filled run by run.

    Attributes
    ----------
    scene : the scene
    protocol : by which it is scored, or its map is shown
    known, hidden : pixels with known truth, and those of them that are occluded; of the shape of the maps
    image : (H, W, 3) RGB or (Z, Y, X) grey levels, or None
    palette : colors and words of the status maps
    data : what ``viewer.js`` reads, as JSON. Of the scene: ``name``, ``protocol``, ``quantity`` and ``unit`` of its
        values, ``low`` and ``high`` of their scale, ``top`` of the errors', ``hidden`` (some pixels are occluded),
        ``words`` of the kinds of pixel, ``status`` (code -> words and color), ``opacity``, ``start`` (first view) and
        ``views``. Of a view, one per slice: ``name``, ``axis``, ``plane``, ``axes`` (of columns and rows), ``tall``
        (height of a pixel over its width), ``width``, ``height``, ``factor`` (it is thinned by), ``image`` (data URI),
        packed ``truth`` and ``region`` (1: known, 2: occluded), and ``runs``: name -> packed ``values``, ``error``,
        ``wrong``, ``status``, and ``confidence`` by measure
    thumbs : run (empty: the scene itself) -> kind of picture -> data URI
    figures, note : without truth: heading with unit -> number, by which scenes are ordered, and their explanation
    mean_confidence : without truth: heading -> mean of a confidence map
    captions : without truth: kind of small picture -> what it shows, with the ends of its scale
    legend : without truth: (words, CSS color) of the statuses in the small picture
    sheet : data URI of a volume's preview, instead of small pictures; or None
    """

    scene: Scene
    protocol: AnyProtocol
    known: NDArray[np.bool_]
    hidden: NDArray[np.bool_]
    image: NDArray[np.uint8] | None
    palette: Palette
    data: dict[str, Any] = field(default_factory=dict)
    thumbs: dict[str, dict[str, str]] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)
    note: str = ""
    mean_confidence: dict[str, float] = field(default_factory=dict)
    captions: dict[str, str] = field(default_factory=dict)
    legend: list[tuple[str, str]] = field(default_factory=list)
    sheet: str | None = None
    _cuts: list[Slice] = field(default_factory=list)
    # What the small error pictures are drawn from, once the scale is known: run -> kinds of pixel, errors, quantile.
    _errors: dict[str, tuple[NDArray[np.uint8], NDArray[np.floating[Any]], float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.scene.name

    def fill(self, true: NDArray[Any] | None, axes: tuple[SliceAxis, ...], scale: tuple[float, float]) -> None:
        """Pack image, truth and regions of every cut; make the small pictures of the scene."""
        shown, known, (low, high) = self.protocol.presentation, self.known, scale
        self._cuts = slices(known.shape)
        self.data = {"name": self.name, "protocol": self.protocol.name, "quantity": shown.quantity, "unit": shown.unit,
                     "low": low, "high": high, "hidden": bool(self.hidden.any()), "status": {}, "views": [],
                     "words": shown.pixel_kind_names, "opacity": shown.opacity,
                     "start": _first_cut(self._cuts, known)}  # fmt: skip
        for cut in self._cuts:
            plane = known[cut.index]
            packed = None if true is None else pack(np.where(plane, true[cut.index], np.nan), *_with_margin(low, high))
            picture = self._image_of(cut)
            rows, columns = [axis for k, axis in enumerate(axes) if k != cut.axis] or (None, None)
            self.data["views"].append(
                {"name": _name(cut, axes), "axis": cut.axis,
                 "plane": axes[cut.axis].plane if axes else f"axis {cut.axis}",
                 "axes": [columns, rows], "tall": abs(rows.step / columns.step) if rows and columns else 1.0,
                 "width": plane.shape[1], "height": plane.shape[0], "factor": 1,
                 "image": None if picture is None else _jpeg(picture), "truth": packed,
                 "region": pack_bytes(plane + 2 * self.hidden[cut.index].astype(np.uint8)), "runs": {}}
            )  # fmt: skip
        cut = self._cuts[self.data["start"]]
        if self.image is not None:
            flat = self.image if cut.axis < 0 else np.stack([self.image[cut.index]] * 3, axis=-1)
            step = _step(flat.shape[:2])
            self.thumbs[""] = {
                "image": _jpeg(_shrunk(flat, max(1, flat.shape[1] // step), max(1, flat.shape[0] // step)))
            }
        if true is not None:
            plane = np.where(known[cut.index], true[cut.index], np.nan)
            self.thumbs.setdefault("", {})["truth"] = self._map_thumb(plane)

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
        protocol, known = self.protocol, self.known
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
        for view, cut in self._add_run(run, values, packed_range, self._status(path), planes):
            view["error"] = None if is_difference else pack(error[cut], 0.0, range_of(error)[1])
            view["wrong"] = pack_bytes(wrong[cut])
        cut = self._cuts[self.data["start"]].index
        step = _step(known[cut].shape)
        kind = pixel_kinds(known[cut], self.hidden[cut], wrong[cut], np.isnan(error[cut]))
        worst = error[wrong & ~np.isnan(error)]
        high = float(np.quantile(worst, 0.9)) if worst.size else math.nan
        self._errors[run] = (kind[::step, ::step], error[cut][::step, ::step], high)
        self.thumbs.setdefault(run, {})["map"] = self._map_thumb(values[cut])

    def add_shown(self, run: str, path: Path, shown: ShownMap) -> None:
        """Add the map of a run without truth: map, status, confidence and expected error."""
        status, error = self._status(path), shown.expected_error
        confidence = {n: plane for n, plane in shown.confidence.items() if plane.shape == shown.values.shape}
        for view, cut in self._add_run(run, shown.values, range_of(shown.values), status, confidence):
            view["error"] = None if error is None else pack(error[cut], 0.0, self.data["top"])
        for each in self.data["views"]:
            each["region"] = None
        self.sheet = _preview(path.with_name("preview.png")) if shown.axes else None
        if self.sheet is not None:  # three slices say more than small pictures of one
            self.thumbs = {}
            return
        words, cut = self.protocol.presentation, self._cuts[self.data["start"]].index
        thumbs = self.thumbs.setdefault(run, {})
        thumbs["map"] = self._map_thumb(shown.values[cut])
        low, high = (f"{float(f'{self.data[end]:.4g}'):g}" for end in ("low", "high"))
        self.captions["map"] = f"{words.quantity}, {low} to {high} {words.unit}"
        if error is not None:
            thumbs["expected error"] = _png(colors.map_picture(_small(error[cut]), 0.0, self.data["top"]))
            self.captions["expected error"] = f"expected error, 0 to {self.data['top']:g} {words.unit}"
        if status is not None:
            thumbs["status"] = _png(self._status_picture(_small(status[cut])))
        more = len(confidence) - _MAX_CONFIDENCES
        for name, plane in list(confidence.items())[:_MAX_CONFIDENCES]:
            grey = confidence_picture(_small(plane[cut]))
            thumbs[_words(name)] = _png(np.repeat(grey[..., None], 3, axis=2))
            self.captions[_words(name)] = f"{_words(name)}, dark: unsure"
        if more > 0:
            self.captions[_words(name)] += f"; {more} more in the viewer"

    def close(self) -> None:
        """Scale the errors by the median of the runs' 90 % quantiles over wrong pixels, and draw their pictures."""
        if self._errors or "top" not in self.data:
            highs = [high for _, _, high in self._errors.values() if not math.isnan(high)]
            self.data["top"] = float(f"{float(np.median(highs)) if highs else 1.0:.2g}") or 1.0
        for run, (kind, error, _) in self._errors.items():
            drawn = self._blended(colors.shaded_picture(kind, error, self.data["top"]), kind == UNKNOWN)
            self.thumbs.setdefault(run, {})["error"] = drawn
        self._errors, self.image = {}, None

    def _add_run(
        self,
        run: str,
        values: NDArray[Any],
        packed_range: tuple[float, float],
        status: NDArray[np.uint8] | None,
        confidence: Mapping[str, NDArray[Any]],
    ) -> Iterator[tuple[dict[str, Any], tuple[Any, ...]]]:
        """Pack the maps of a run, cut by cut; yield each cut's entry of the run, without errors, and its index."""
        for view, cut in zip(self.data["views"], (each.index for each in self._cuts), strict=True):
            view["runs"][run] = {
                "values": pack(values[cut], *packed_range),
                "error": None,
                "wrong": None,
                "status": None if status is None else pack_bytes(status[cut]),
                "confidence": {name: _pack_confidence(plane[cut]) for name, plane in confidence.items()},
            }
            yield view["runs"][run], cut

    def _map_thumb(self, plane: NDArray[np.floating[Any]]) -> str:
        small = _small(plane)
        return self._blended(colors.map_picture(small, self.data["low"], self.data["high"]), np.isnan(small))

    def _blended(self, small: NDArray[np.uint8], nothing: NDArray[np.bool_]) -> str:
        """Return a small picture over the image of the first cut, which is alone at ``nothing``."""
        image = self._image_of(self._cuts[self.data["start"]])
        beneath = None if image is None else _small(image)
        return _png(colors.overlaid(small, nothing, beneath, self.protocol.presentation.opacity))

    def _image_of(self, cut: Slice) -> NDArray[np.uint8] | None:
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

    def _status(self, path: Path) -> NDArray[np.uint8] | None:
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

    def _status_picture(self, status: NDArray[np.uint8]) -> NDArray[np.uint8]:
        table = np.full((256, 3), colors.NO_VALUE, np.uint8)
        for value, entry in self.data["status"].items():
            table[int(value)] = entry["color"]
            color = "rgb({},{},{})".format(*entry["color"])
            if color not in (known for _, known in self.legend):
                self.legend.append((entry["words"].removesuffix(", smoothed"), color))
        return table[status]


def view_with_truth(protocol: AnyProtocol, scene: Scene, truth: Any) -> SceneView | None:
    """Return the view of a scene without runs; None if its points lie on no grid."""
    shown = protocol.presentation
    known, hidden = (shown.on_grid(pixels, truth) for pixels in shown_pixels(protocol, truth))
    if known is None or hidden is None:
        return None
    view = SceneView(scene, protocol, known, hidden, shown.image(scene), shown.palette)
    true = shown.on_grid(truth.values, truth)
    view.fill(true, shown.axes(truth), range_of(None if true is None else true[known]))
    return view


def view_of_run(protocol: AnyProtocol, scene: Scene, run: str, path: Path, palette: Palette | None) -> SceneView:
    """Return the view of the map ``path`` of a scene without truth; InputError if it cannot be read."""
    presentation = protocol.presentation
    shown = presentation.show(path, scene, protocol.files)
    nothing = np.zeros(shown.values.shape, np.bool_)
    colored = presentation.palette if palette is None else palette
    view = SceneView(scene, protocol, nothing, nothing, presentation.image(scene), colored)
    view.figures, view.note = dict(shown.figures), shown.note
    for name, plane in list(shown.confidence.items())[:_MAX_CONFIDENCES]:
        finite = plane[np.isfinite(plane)]
        view.mean_confidence[f"{_words(name)}, mean"] = float(finite.mean()) if finite.size else np.nan
    view.fill(None, shown.axes, presentation.scale or _scale(shown.values))
    view.data["top"] = 1.0 if shown.expected_error is None else float(f"{_scale(shown.expected_error)[1]:.2g}")
    view.add_shown(run, path, shown)
    return view


def smaller(data: dict[str, Any], factor: int) -> dict[str, Any]:
    """Return a scene's data with every ``factor``-th pixel."""
    views = []
    for view in data["views"]:
        height, width = (-(-view[side] // factor) for side in ("height", "width"))
        views.append(thinned(view, factor) | {"height": height, "width": width, "factor": factor})
        if view["image"] is not None:
            code = np.frombuffer(base64.b64decode(view["image"].partition(",")[2]), np.uint8)
            picture = cv2.imdecode(code, cv2.IMREAD_COLOR)
            assert picture is not None  # it was written here
            views[-1]["image"] = _jpeg(np.asarray(cv2.resize(picture, (width, height))[..., ::-1], np.uint8))
    return {**data, "views": views}


def _first_cut(cuts: list[Slice], known: NDArray[np.bool_]) -> int:
    """Return the cut to begin with: of the first axis the one with most known pixels, of such ones the most central."""
    first = [number for number, cut in enumerate(cuts) if cut.axis == cuts[0].axis]
    middle = cuts[0].count // 2
    n_known = {n: int(np.count_nonzero(known[cuts[n].index])) for n in first}
    return max(first, key=lambda n: (n_known[n], -abs(cuts[n].place - middle)))


def _with_margin(low: float, high: float) -> tuple[float, float]:
    return low - _MARGIN * (high - low), high + _MARGIN * (high - low)


def _name(cut: Slice, axes: tuple[SliceAxis, ...]) -> str:
    """Return the plane of a cut, where it lies, and its number; empty for an image."""
    number = f"{cut.place + 1} of {cut.count}"
    if cut.axis < 0 or not axes:
        return "" if cut.axis < 0 else number
    axis = axes[cut.axis]
    return f"{axis.plane}, {side_and_distance(axis.ends, axis.first + axis.step * cut.place)}, {number}"


def _words(confidence: str) -> str:
    return "confidence" if confidence == "confidence" else f"confidence {confidence}"


def range_of(values: NDArray[np.floating[Any]] | None) -> tuple[float, float]:
    """Return the lowest and highest finite value, never the same; (0, 1) if there is none."""
    finite = np.array([]) if values is None else values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    return low, max(high, low + 1e-3)


def _scale(values: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Return quantiles of the finite values, never the same; (0, 1) if there is none."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, _QUANTILES).tolist() if finite.size else (0.0, 1.0)
    return low, max(high, low + 1e-3)


def _pack_confidence(plane: NDArray[Any]) -> Packed:
    values = plane.astype(np.float64)
    finite = values[np.isfinite(values)]
    shown = np.percentile(finite, _QUANTILES).tolist() if finite.size else [0.0, 1.0]
    return {**pack(values, *range_of(values), _CONFIDENCE_LEVELS), "shown": shown}


def _step(shape: tuple[int, ...]) -> int:
    return max(1, -(-max(shape[:2]) // _MAX_THUMB))


def _small(plane: NDArray[Any]) -> NDArray[Any]:
    step = _step(plane.shape)
    return plane[::step, ::step]


def _shrunk(picture: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _preview(file: Path) -> str | None:
    """Return the preview of a volume as a JPEG of the page's width; None if it was not kept."""
    try:
        picture = read_image(file)
    except InputError:
        return None
    height, width = picture.shape[:2]
    return _jpeg(
        _shrunk(
            np.asarray(picture, np.uint8), min(width, _MAX_SHEET), max(1, round(height * min(1.0, _MAX_SHEET / width)))
        )
    )


def _jpeg(picture: NDArray[np.uint8]) -> str:
    return _uri("image/jpeg", cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])


def _png(picture: NDArray[np.uint8]) -> str:
    return _uri("image/png", cv2.imencode(".png", picture[..., ::-1])[1])


def _uri(kind: str, data: Any) -> str:
    return f"data:{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
