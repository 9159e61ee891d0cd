"""A scene as the page shows it: its maps packed for the script, and small pictures for readers without one."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.volumes import side_and_distance
from depthcli.evaluation.presentation import UNKNOWN, Axis, ShownMap, pixel_kinds
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.io.formats.pictures import Palette, read_status, status_color, status_words
from depthcli.io.scenes import Scene
from depthcli.report import colors
from depthcli.report.packing import Packed, Slice, pack, pack_bytes, slices, thinned

_CONFIDENCE_LEVELS = 4096  # of a packed confidence; noise below them would only fill the page
_MAX_THUMB = 240  # pixels of a small picture's longer side
_MARGIN = 0.5  # values up to this share of the truth's range beside it are packed, those beyond as out of range
_JPEG_QUALITY = 88  # at which artifacts are not visible beneath a map


@dataclass
class SceneView:
    """One scene, filled run by run.

    Attributes
    ----------
    scene : the scene
    protocol : by which it is scored
    image : (H, W, 3) RGB or (Z, Y, X) grey levels, or None
    known, hidden : pixels with known truth, and those of them that are occluded; of the shape of the maps
    palette : colors and words of the status maps; None: the presentation's
    data : what ``viewer.js`` reads, as JSON. Of the scene: ``name``, ``protocol``, ``quantity`` and ``unit`` of its
        values, ``low`` and ``high`` of their scale, ``top`` of the errors', ``hidden`` (some pixels are occluded),
        ``words`` of the kinds of pixel, ``status`` (code -> words and color), ``opacity``, ``start`` (first view) and
        ``views``. Of a view, one per slice: ``name``, ``axis``, ``plane``, ``axes`` (of columns and rows), ``tall``
        (height of a pixel over its width), ``width``, ``height``, ``factor`` (it is thinned by), ``image`` (data URI),
        packed ``truth`` and ``region`` (1: known, 2: occluded), and ``runs``: name -> packed ``values``, ``error``,
        ``wrong``, ``status``, and ``confidence`` by measure
    thumbs : run (empty: the scene itself) -> kind of picture -> data URI
    """

    scene: Scene
    protocol: AnyProtocol
    image: NDArray[np.uint8] | None
    known: NDArray[np.bool_]
    hidden: NDArray[np.bool_]
    palette: Palette | None = None
    data: dict[str, Any] = field(default_factory=dict)
    thumbs: dict[str, dict[str, str]] = field(default_factory=dict)
    _cuts: list[Slice] = field(default_factory=list)
    # What the small error pictures are drawn from, once the scale is known: run -> kinds of pixel, errors, quantile.
    _errors: dict[str, tuple[NDArray[np.uint8], NDArray[np.floating[Any]], float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.scene.name

    @classmethod
    def of(cls, protocol: AnyProtocol, scene: Scene, truth: Any) -> SceneView | None:
        """Return the view of a scene without runs; None where its points lie on no grid."""
        shown = protocol.presentation
        known_grid, hidden_grid = (shown.on_grid(pixels, truth) for pixels in protocol.shown_pixels(truth))
        if known_grid is None or hidden_grid is None:
            return None
        view = cls(scene, protocol, shown.image(scene), known_grid, hidden_grid)
        points = protocol.true_values(truth)
        true = None if points is None else shown.on_grid(points, truth)
        view._fill(true, shown.axes(truth), range_of(None if true is None else true[known_grid]))
        return view

    def _fill(self, true: NDArray[Any] | None, axes: tuple[Axis, ...], scale: tuple[float, float]) -> None:
        """Pack image, truth and regions of every cut; make the small pictures of the scene."""
        shown, known, (low, high) = self.protocol.presentation, self.known, scale
        self._cuts = slices(known.shape)
        self.data = {"name": self.name, "protocol": self.protocol.name, "quantity": shown.quantity, "unit": shown.unit,
                     "low": low, "high": high, "hidden": bool(self.hidden.any()), "status": {}, "views": [],
                     "words": shown.pixel_kind_names, "opacity": shown.opacity,
                     "start": self._first_cut()}  # fmt: skip
        for cut in self._cuts:
            plane = known[cut.index]
            packed = None if true is None else pack(np.where(plane, true[cut.index], np.nan), *self._packed_range)
            picture = self._image_of(cut)
            rows, columns = [axis for k, axis in enumerate(axes) if k != cut.axis] or (None, None)
            self.data["views"].append(
                {"name": _name(cut, axes), "axis": cut.axis,
                 "plane": axes[cut.axis].plane if axes else f"axis {cut.axis}",
                 "axes": [columns, rows], "tall": abs(rows.step / columns.step) if rows and columns else 1.0,
                 "width": plane.shape[1], "height": plane.shape[0], "factor": 1,
                 "image": None if picture is None else jpeg(picture), "truth": packed,
                 "region": pack_bytes(plane + 2 * self.hidden[cut.index].astype(np.uint8)), "runs": {}}
            )  # fmt: skip
        cut = self._cuts[self.data["start"]]
        if self.image is not None:
            flat = self.image if cut.axis < 0 else np.stack([self.image[cut.index]] * 3, axis=-1)
            step = step_of(flat.shape[:2])
            size = (max(1, flat.shape[1] // step), max(1, flat.shape[0] // step))
            shrunk = np.asarray(cv2.resize(flat, size, interpolation=cv2.INTER_AREA), np.uint8)
            self.thumbs[""] = {"image": jpeg(shrunk)}
        if true is not None:
            plane = np.where(known[cut.index], true[cut.index], np.nan)
            self.thumbs.setdefault("", {})["truth"] = self._map_thumb(plane)

    def _first_cut(self) -> int:
        """The cut to begin with: of the first axis the one with most known pixels, of such ones the most central."""
        first = [number for number, cut in enumerate(self._cuts) if cut.axis == self._cuts[0].axis]
        middle = self._cuts[0].count // 2
        n_known = {n: int(np.count_nonzero(self.known[self._cuts[n].index])) for n in first}
        return max(first, key=lambda n: (n_known[n], -abs(self._cuts[n].place - middle)))

    @property
    def _packed_range(self) -> tuple[float, float]:
        low, high = self.data["low"], self.data["high"]
        return low - _MARGIN * (high - low), high + _MARGIN * (high - low)

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

        def on_grid(points: NDArray[Any] | None) -> Any:
            return None if points is None else protocol.presentation.on_grid(points, truth)

        error = np.where(known, on_grid(protocol.error(estimate, truth)), np.nan)
        wrong = on_grid(protocol.wrong(estimate, truth)) & known
        values, true = on_grid(protocol.values(estimate, truth)), on_grid(protocol.true_values(truth))
        planes, packed_range = {name: on_grid(plane) for name, plane in confidences.items()}, self._packed_range
        if dense is not None and dense.values.shape == known.shape:
            values, planes, packed_range = dense.values, dense.confidence, range_of(dense.values)
        # The script takes the difference of values and truth where that is the error.
        is_difference = values is not None and true is not None and np.allclose(
            error[known], np.abs(values - true)[known], rtol=1e-4, atol=1e-4, equal_nan=True
        )  # fmt: skip
        status = self._status(path)
        for view, cut in zip(self.data["views"], (each.index for each in self._cuts), strict=True):
            view["runs"][run] = {
                "values": None if values is None else pack(values[cut], *packed_range),
                "error": None if is_difference else pack(error[cut], 0.0, range_of(error)[1]),
                "wrong": pack_bytes(wrong[cut]),
                "status": None if status is None else pack_bytes(status[cut]),
                "confidence": {name: pack_confidence(plane[cut]) for name, plane in planes.items()},
            }
        cut = self._cuts[self.data["start"]].index
        step = step_of(known[cut].shape)
        kind = pixel_kinds(known[cut], self.hidden[cut], wrong[cut], np.isnan(error[cut]))
        worst = error[wrong & ~np.isnan(error)]
        high = float(np.quantile(worst, 0.9)) if worst.size else math.nan
        self._errors[run] = (kind[::step, ::step], error[cut][::step, ::step], high)
        if values is not None:
            self.thumbs.setdefault(run, {})["map"] = self._map_thumb(values[cut])

    def close(self) -> None:
        """Scale the errors by the median of the runs' 90 % quantiles over wrong pixels, and draw their pictures."""
        highs = [high for _, _, high in self._errors.values() if not math.isnan(high)]
        top = float(f"{float(np.median(highs)) if highs else 1.0:.2g}") or 1.0
        self.data["top"] = top
        for run, (kind, error, _) in self._errors.items():
            picture = self._blended(colors.shaded_picture(kind, error, top), kind == UNKNOWN)
            self.thumbs.setdefault(run, {})["error"] = picture
        self._errors, self.image = {}, None

    def _map_thumb(self, plane: NDArray[np.floating[Any]]) -> str:
        step = step_of(plane.shape)
        small = plane[::step, ::step]
        return self._blended(colors.map_picture(small, self.data["low"], self.data["high"]), np.isnan(small))

    def _blended(self, small: NDArray[np.uint8], nothing: NDArray[np.bool_]) -> str:
        """Return a small picture over the image of the first cut, which is alone at ``nothing``."""
        image = self._image_of(self._cuts[self.data["start"]])
        beneath = None if image is None else image[:: (step := step_of(image.shape[:2])), ::step]
        return png(colors.overlaid(small, nothing, beneath, self.protocol.presentation.opacity))

    def _image_of(self, cut: Slice) -> NDArray[np.uint8] | None:
        """(H, W, 3) RGB image beneath a cut of the maps, at their size; None where its shape does not fit."""
        shape = self.known.shape
        if self.image is None:
            return None
        if cut.axis >= 0:
            return np.stack([self.image[cut.index]] * 3, axis=-1) if self.image.shape == shape else None
        height, width = self.image.shape[:2]
        if abs(width * shape[0] - height * shape[1]) > 2 * max(width, height):
            return None
        fitted = self.image if (height, width) == shape else cv2.resize(self.image, shape[::-1])
        return np.asarray(fitted, np.uint8)

    def _status(self, path: Path) -> NDArray[np.uint8] | None:
        palette = self.protocol.presentation.palette if self.palette is None else self.palette
        file = self.protocol.files.status(path) if palette else None
        try:
            status = None if file is None else read_status(file)
        except InputError:  # the map counts, the status beside it is an extra
            return None
        if status is None or status.shape != self.known.shape:
            return None
        for value in np.unique(status).tolist():
            words, color = status_words(value, palette), status_color(value, palette)
            self.data["status"][str(value)] = {"words": words, "color": color}
        return status


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
            views[-1]["image"] = jpeg(np.asarray(cv2.resize(picture, (width, height))[..., ::-1], np.uint8))
    return {**data, "views": views}


def _name(cut: Slice, axes: tuple[Axis, ...]) -> str:
    """The plane of a cut, where it lies, and its number; empty for an image."""
    number = f"{cut.place + 1} of {cut.count}"
    if cut.axis < 0 or not axes:
        return "" if cut.axis < 0 else number
    axis = axes[cut.axis]
    return f"{axis.plane}, {side_and_distance(axis.ends, axis.first + axis.step * cut.place)}, {number}"


def range_of(values: NDArray[np.floating[Any]] | None) -> tuple[float, float]:
    """Lowest and highest finite value, never the same; (0, 1) where there is none."""
    finite = np.array([]) if values is None else values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    return low, max(high, low + 1e-3)


def pack_confidence(plane: NDArray[Any]) -> Packed:
    values = plane.astype(np.float64)
    finite = values[np.isfinite(values)]
    shown = np.percentile(finite, (1, 99)).tolist() if finite.size else [0.0, 1.0]
    return {**pack(values, *range_of(values), _CONFIDENCE_LEVELS), "shown": shown}


def step_of(shape: tuple[int, ...]) -> int:
    return max(1, -(-max(shape) // _MAX_THUMB))


def jpeg(picture: NDArray[np.uint8]) -> str:
    return _uri("image/jpeg", cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])


def png(picture: NDArray[np.uint8]) -> str:
    return _uri("image/png", cv2.imencode(".png", picture[..., ::-1])[1])


def _uri(kind: str, data: Any) -> str:
    return f"data:{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
