"""A run's maps of a scene without ground truth, as the page shows them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.evaluation.presentation import ShownMap
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.io.formats.images import read_image
from depthcli.io.formats.pictures import Palette, confidence_picture
from depthcli.io.scenes import Scene
from depthcli.report import colors
from depthcli.report.packing import pack, pack_bytes
from depthcli.report.scene_view import SceneView, jpeg, pack_confidence, png, range_of, step_of

_MAX_SHEET = 1056  # pixels, width of the preview of a volume in the page
_MAX_CONFIDENCES = 4  # with a small picture and a mean; the others are in the viewer
_QUANTILES = (1, 99)  # percent, of the values that span the colors where nothing else gives their scale


@dataclass
class RunView(SceneView):
    """One scene of a run, without truth: image, map, status, confidence and expected error.

    Attributes
    ----------
    figures : heading with unit -> number, by which scenes are ordered
    note : explanation of the figures
    mean_confidence : heading -> mean of a confidence map
    captions : kind of small picture -> what it shows, with the ends of its scale
    legend : (words, CSS color) of the statuses in the small picture
    sheet : data URI of a volume's preview, instead of small pictures; or None
    """

    figures: dict[str, float] = field(default_factory=dict)
    note: str = ""
    mean_confidence: dict[str, float] = field(default_factory=dict)
    captions: dict[str, str] = field(default_factory=dict)
    legend: list[tuple[str, str]] = field(default_factory=list)
    sheet: str | None = None

    @classmethod
    def of_run(cls, protocol: AnyProtocol, scene: Scene, run: str, path: Path, palette: Palette | None) -> Self:
        """Return the view of the map ``path``; InputError where it cannot be read."""
        shown = protocol.shown_map(path, scene)
        nothing = np.zeros(shown.values.shape, np.bool_)
        view = cls(scene, protocol, protocol.presentation.image(scene), nothing, nothing, palette)
        view.figures, view.note = dict(shown.figures), shown.note
        for name, plane in list(shown.confidence.items())[:_MAX_CONFIDENCES]:
            finite = plane[np.isfinite(plane)]
            view.mean_confidence[f"{_words(name)}, mean"] = float(finite.mean()) if finite.size else np.nan
        scale = protocol.presentation.scale or _scale(shown.values)
        view._fill(None, shown.axes, scale)
        view.data["top"] = 1.0 if shown.expected_error is None else float(f"{_scale(shown.expected_error)[1]:.2g}")
        view._add_run(run, path, shown)
        return view

    def close(self) -> None:
        """Let go of the image."""
        self.image = None

    def _add_run(self, run: str, path: Path, shown: ShownMap) -> None:
        """Pack the maps of every cut, and make the small pictures."""
        status, error = self._status(path), shown.expected_error
        confidence = {n: plane for n, plane in shown.confidence.items() if plane.shape == shown.values.shape}
        for view, cut in zip(self.data["views"], (each.index for each in self._cuts), strict=True):
            view["region"] = None
            view["runs"][run] = {
                "values": pack(shown.values[cut], *range_of(shown.values)),
                "error": None if error is None else pack(error[cut], 0.0, self.data["top"]),
                "wrong": None,
                "status": None if status is None else pack_bytes(status[cut]),
                "confidence": {name: pack_confidence(plane[cut]) for name, plane in confidence.items()},
            }
        self.sheet = _preview(path.with_name("preview.png")) if shown.axes else None
        if self.sheet is not None:  # three slices say more than small pictures of one
            self.thumbs = {}
            return
        words, cut = self.protocol.presentation, self._cuts[self.data["start"]].index
        low, high = self.data["low"], self.data["high"]
        thumbs = self.thumbs.setdefault(run, {})
        thumbs["map"] = self._map_thumb(shown.values[cut])
        self.captions["map"] = f"{words.quantity}, {_short(low)} to {_short(high)} {words.unit}"
        if error is not None:
            small = _small(error[cut])
            thumbs["expected error"] = png(colors.map_picture(small, 0.0, self.data["top"]))
            self.captions["expected error"] = f"expected error, 0 to {self.data['top']:g} {words.unit}"
        if status is not None:
            thumbs["status"] = png(self._status_picture(_small(status[cut])))
        more = len(confidence) - _MAX_CONFIDENCES
        for name, plane in list(confidence.items())[:_MAX_CONFIDENCES]:
            grey = confidence_picture(_small(plane[cut]))
            thumbs[_words(name)] = png(np.repeat(grey[..., None], 3, axis=2))
            self.captions[_words(name)] = f"{_words(name)}, dark: unsure"
        if more > 0:
            self.captions[_words(name)] += f"; {more} more in the viewer"

    def _status_picture(self, status: NDArray[np.uint8]) -> NDArray[np.uint8]:
        table = np.full((256, 3), colors.NO_VALUE, np.uint8)
        for value, entry in self.data["status"].items():
            table[int(value)] = entry["color"]
            color = "rgb({},{},{})".format(*entry["color"])
            if color not in (known for _, known in self.legend):
                self.legend.append((entry["words"].removesuffix(", smoothed"), color))
        return table[status]


def _words(confidence: str) -> str:
    return "confidence" if confidence == "confidence" else f"confidence {confidence}"


def _scale(values: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Quantiles of the finite values, never the same; (0, 1) where there is none."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, _QUANTILES).tolist() if finite.size else (0.0, 1.0)
    return low, max(high, low + 1e-3)


def _short(value: float) -> str:
    return f"{float(f'{value:.4g}'):g}"


def _small(plane: NDArray[Any]) -> NDArray[Any]:
    step = step_of(plane.shape)
    return plane[::step, ::step]


def _preview(file: Path) -> str | None:
    """The preview of a volume as a JPEG of the page's width; None where it was not kept."""
    try:
        picture = read_image(file)
    except InputError:
        return None
    height, width = picture.shape[:2]
    size = (min(width, _MAX_SHEET), max(1, round(height * min(1.0, _MAX_SHEET / width))))
    return jpeg(np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8))
