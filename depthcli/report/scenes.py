"""A scene as the page shows it: its maps packed for the script, small pictures for readers without one."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.data.formats.pictures import read_status, status_color, status_words
from depthcli.data.scenes import Scene as InputScene
from depthcli.evaluation.protocols import Protocol
from depthcli.evaluation.results import Result
from depthcli.report import colors
from depthcli.report.planes import Cut, Packed, cuts, pack, pack_bytes, thinned

_CONFIDENCES = 4096  # levels of a confidence; noise below them would only fill the page
_THUMB = 240  # pixels of a small picture's longer side, at most
_MARGIN = 0.5  # values that lie so many ranges of the truth beside it are shown as out of range


@dataclass
class _Small:
    """What the small picture of an error is drawn from, when the scene's scale is known."""

    error: NDArray[np.floating[Any]]
    kind: NDArray[np.uint8]
    high: float
    under: NDArray[np.uint8] | None


@dataclass
class ScenePage:
    """One scene, filled run by run.

    Attributes
    ----------
    name : of the scene
    judge : its protocol
    image : (H, W, 3) RGB or (Z, Y, X) grey, or None
    data : what the script reads
    thumbs : name of a picture -> data URI; of a run: ``map``, ``error``
    """

    name: str
    judge: Protocol[Any, Any]
    image: NDArray[np.uint8] | None
    data: dict[str, Any] = field(default_factory=dict)
    thumbs: dict[str, dict[str, str]] = field(default_factory=dict)
    _cuts: list[Cut] = field(default_factory=list)
    _small: dict[str, _Small] = field(default_factory=dict)

    @classmethod
    def of(cls, judge: Protocol[Any, Any], item: InputScene, truth: Any) -> ScenePage | None:
        """A scene without runs yet; None where there is nothing to look at."""
        found = _regions(judge, truth)
        if found is None:
            return None
        known, hidden = found
        scene = cls(item.name, judge, judge.image(item))
        points = judge.true_values(truth)
        true = None if points is None else judge.laid_out(points, truth)
        low, high = _range(None if true is None else true[known])
        scene._cuts = cuts(known.shape)
        start = scene._start(known)
        scene.data = {"name": item.name, "protocol": judge.name, "quantity": judge.quantity, "unit": judge.unit,
                      "low": low, "high": high, "hidden": bool(hidden.any()), "status": {}, "views": [],
                      "words": colors.words(*judge.verdicts), "opacity": judge.opacity, "start": start}  # fmt: skip
        spacing = judge.spacing(truth)
        for cut in scene._cuts:
            plane = known[cut.index]
            packed = None if true is None else pack(np.where(plane, true[cut.index], np.nan), *scene._reach)
            picture = scene._picture(cut, known.shape)
            across = [1.0, 1.0] if spacing is None else [s for axis, s in enumerate(spacing) if axis != cut.axis]
            scene.data["views"].append(
                {"name": cut.name, "axis": cut.axis, "axes": cut.axes, "tall": across[0] / across[1],
                 "width": plane.shape[1], "height": plane.shape[0], "factor": 1,
                 "image": None if picture is None else _jpeg(picture), "truth": packed,
                 "region": pack_bytes(plane + 2 * hidden[cut.index].astype(np.uint8)), "runs": {}}
            )  # fmt: skip
        cut = scene._cuts[start]
        if scene.image is not None:
            flat = scene.image if cut.axis < 0 else colors.grey(scene.image[cut.index])
            scene.thumbs[""] = {"image": _jpeg(_shrunk(flat))}
        if true is not None:
            step = _step(known[cut.index].shape)
            small = np.where(known[cut.index], true[cut.index], np.nan)[::step, ::step]
            picture = colors.map_picture(small, low, high)
            picture = colors.over(picture, np.isnan(small), scene._under(known.shape), judge.opacity)
            scene.thumbs.setdefault("", {})["truth"] = _png(picture)
        return scene

    def _start(self, known: NDArray[np.bool_]) -> int:
        """The plane to begin with: of the first axis the one with most to see, of such ones the most central."""
        first = [number for number, cut in enumerate(self._cuts) if cut.axis == self._cuts[0].axis]
        middle = self._cuts[0].count // 2
        seen = {n: int(np.count_nonzero(known[self._cuts[n].index])) for n in first}
        return max(first, key=lambda n: (seen[n], -abs(self._cuts[n].place - middle)))

    def _under(self, shape: tuple[int, ...]) -> NDArray[np.uint8] | None:
        """The image of the plane to begin with, as small as the small pictures of maps."""
        picture = self._picture(self._cuts[self.data["start"]], shape)
        if picture is None:
            return None
        step = _step(picture.shape[:2])
        return picture[::step, ::step]

    @property
    def _reach(self) -> tuple[float, float]:
        low, high = self.data["low"], self.data["high"]
        return low - _MARGIN * (high - low), high + _MARGIN * (high - low)

    def add(self, result: Result, path: Any, estimate: Any, truth: Any, confidences: dict[str, NDArray[Any]]) -> None:
        """One run's map."""
        judge, found = self.judge, _regions(self.judge, truth)
        assert found is not None
        known, hidden = found

        def laid(points: NDArray[Any] | None) -> Any:
            return None if points is None else judge.laid_out(points, truth)

        error = np.where(known, laid(judge.error(estimate, truth)), np.nan)
        wrong = laid(judge.wrong(estimate, truth)) & known
        values, true = laid(judge.values(estimate, truth)), laid(judge.true_values(truth))
        follows = values is not None and true is not None and _same(error, np.abs(values - true), known)
        status = self._status(path, known.shape)
        for view, cut in zip(self.data["views"], (each.index for each in self._cuts), strict=True):
            run: dict[str, Packed | dict[str, Packed] | None] = {
                "values": None if values is None else pack(values[cut], *self._reach),
                # The script takes the difference where that is the error.
                "error": None if follows else pack(error[cut], 0.0, _largest(error)),
                "wrong": pack_bytes(wrong[cut]),
                "status": None if status is None else pack_bytes(status[cut]),
                "confidence": {name: _pack_confidence(laid(plane)[cut]) for name, plane in confidences.items()},
            }
            view["runs"][result.run] = run
        cut = self._cuts[self.data["start"]].index
        step = _step(known[cut].shape)
        under = self._under(known.shape)
        kind = colors.kinds(known[cut], hidden[cut], wrong[cut], np.isnan(error[cut]))
        worst = error[wrong & ~np.isnan(error)]
        high = float(np.quantile(worst, 0.9)) if worst.size else math.nan
        self._small[result.run] = _Small(error[cut][::step, ::step], kind[::step, ::step], high, under)
        if values is not None:
            small = values[cut][::step, ::step]
            picture = colors.map_picture(small, self.data["low"], self.data["high"])
            picture = colors.over(picture, np.isnan(small), under, judge.opacity)
            self.thumbs.setdefault(result.run, {})["map"] = _png(picture)

    def close(self) -> None:
        """Settle the scale of the errors: the darkest is what most runs' worst tenth of wrong pixels exceeds."""
        highs = [small.high for small in self._small.values() if not math.isnan(small.high)]
        top = float(f"{float(np.median(highs)) if highs else 1.0:.2g}") or 1.0
        self.data["top"] = top
        for run, small in self._small.items():
            picture = colors.error_picture(small.kind, small.error, top)
            picture = colors.over(picture, small.kind == colors.UNKNOWN, small.under, self.judge.opacity)
            self.thumbs.setdefault(run, {})["error"] = _png(picture)
        self._small, self.image = {}, None

    def _picture(self, cut: Cut, shape: tuple[int, ...]) -> NDArray[np.uint8] | None:
        """What is beneath a plane of the maps, (H, W, 3) RGB at their size; None where it is of another shape."""
        if self.image is None:
            return None
        if cut.axis >= 0:
            return colors.grey(self.image[cut.index]) if self.image.shape == shape else None
        height, width = self.image.shape[:2]
        if abs(width * shape[0] - height * shape[1]) > 2 * max(width, height):
            return None
        fitted = self.image if (height, width) == shape else cv2.resize(self.image, shape[::-1])
        return np.asarray(fitted, np.uint8)

    def _status(self, path: Any, shape: tuple[int, ...]) -> NDArray[np.uint8] | None:
        file = self.judge.status(path)
        try:
            status = None if file is None else read_status(file)
        except InputError:  # the map counts, what lies beside it is an extra
            return None
        if status is None or status.shape != shape:
            return None
        for value in np.unique(status).tolist():
            words, color = status_words(value, self.judge.palette), status_color(value, self.judge.palette)
            self.data["status"][str(value)] = {"words": words, "color": color}
        return status


def _regions(judge: Protocol[Any, Any], truth: Any) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
    """Pixels whose truth is known, and those of them that are occluded; None where they lie on no grid."""
    regions = judge.regions(truth)
    known = np.logical_or.reduce(list(regions.values()))
    seen = regions.get(judge.visible)
    hidden = np.zeros_like(known) if seen is None else known & ~seen
    laid = judge.laid_out(known, truth), judge.laid_out(hidden, truth)
    return None if laid[0] is None or laid[1] is None else (laid[0], laid[1])


def smaller(data: dict[str, Any], factor: int) -> dict[str, Any]:
    """A scene's data with every ``factor``-th pixel."""
    return {**data, "views": [_smaller(view, factor) for view in data["views"]]}


def _smaller(view: dict[str, Any], factor: int) -> dict[str, Any]:
    def thin(value: Any) -> Any:
        if isinstance(value, dict):
            if "data" in value:
                return {**value, **thinned(value, factor)}
            return {name: thin(inner) for name, inner in value.items()}
        return value

    made = {**view, **{name: thin(view[name]) for name in ("truth", "region", "runs")}, "factor": factor}
    made["height"], made["width"] = made["region"]["height"], made["region"]["width"]
    if view["image"] is not None:
        code = np.frombuffer(base64.b64decode(view["image"].partition(",")[2]), np.uint8)
        picture = cv2.imdecode(code, cv2.IMREAD_COLOR)
        assert picture is not None  # it was written here
        picture = cv2.resize(picture, (made["width"], made["height"]))
        made["image"] = _jpeg(np.asarray(picture[..., ::-1], np.uint8))
    return made


def _range(values: NDArray[np.floating[Any]] | None) -> tuple[float, float]:
    finite = np.array([]) if values is None else values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    return low, max(high, low + 1e-3)


def _largest(error: NDArray[np.floating[Any]]) -> float:
    return _range(error)[1]


def _same(error: NDArray[Any], difference: NDArray[Any], known: NDArray[np.bool_]) -> bool:
    return np.allclose(error[known], difference[known], rtol=1e-4, atol=1e-4, equal_nan=True)


def _pack_confidence(plane: NDArray[Any]) -> Packed:
    values = plane.astype(np.float64)
    low, high = _range(values)
    finite = values[np.isfinite(values)]
    shown = np.percentile(finite, (1, 99)).tolist() if finite.size else [0.0, 1.0]
    return {**pack(values, low, high, _CONFIDENCES), "shown": shown}


def _step(shape: tuple[int, ...]) -> int:
    return max(1, -(-max(shape) // _THUMB))


def _shrunk(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    step = _step(image.shape[:2])
    size = (max(1, image.shape[1] // step), max(1, image.shape[0] // step))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _jpeg(picture: NDArray[np.uint8]) -> str:
    return _uri("image/jpeg", cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1])


def _png(picture: NDArray[np.uint8]) -> str:
    return _uri("image/png", cv2.imencode(".png", picture[..., ::-1])[1])


def _uri(kind: str, data: Any) -> str:
    return f"data:{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
