"""Pairs of a calibrated rig made to correspond: what ``rectify`` and the commands that match pairs have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.cameras.rig import RectifiedRig
    from depthcli.core.frames import StereoPair
    from depthcli.io.scenes.stereo import StereoScene
    from depthcli.methods.stereo.config import Calibration
    from depthcli.methods.stereo.rectification import Points, RectifyingHomographies
    from depthcli.methods.stereo.search_range import KeyPointRange

UNIT = Option("unit", str, "Unit of the translation in an OpenCV calibration: m, cm or mm.", "UNIT", group="Input")

_MAX_ROW_ERROR = 1.0  # median row error of a calibrated pair, pixels; with more a scene has a warning
_MIN_SPREAD = 1.0  # of the disparities of a pair without calibration, pixels; with less a scene has a warning


def check_unit(unit: str) -> None:
    """Raise ConfigError where ``--unit`` names no unit of length that calibrations have."""
    if unit not in ("m", "cm", "mm"):
        raise ConfigError(f"--unit: must be m, cm or mm (got {unit!r})")


def rectified_pair(
    calibration: Calibration, scene: StereoScene, folder: Path
) -> tuple[StereoPair, Callable[[], None], Row, list[str]]:
    """Rectify the scene's pair.

    Rows are compared in single pairs and the first frames of sequences: the others have the same cameras.

    Returns
    -------
    pair : the rectified pair
    save : writes the rectified left image and the calibration into ``folder``
    facts, warnings : columns of the report, and lines for the user

    Raises
    ------
    InputError
        The images or the calibration cannot be used.
    """
    from depthcli.api.matching import rectified_rig

    left, right = scene.load_views()
    found = rectified_rig(calibration, left, right)
    pair, view = _pair_of(found, scene, left, right)
    facts, warnings = row_errors(match_rows(left, right), found) if scene.is_first else ({}, [])
    if scene.has_truth:
        warnings.append("the map is that of the rectified image, the scene's ground truth is not: do not compare them")
    return pair, partial(save_views, folder, {"left": view}, found), facts, warnings


def sequence_range(calibration: Calibration | None, frames: Sequence[StereoScene]) -> KeyPointRange | None:
    """Return the search range that key points of frames of a sequence give together; None where too few match in all.

    The latest one is kept for the other frames of the sequence, until the files change. Frames in which too few key
    points match, or which cannot be read, do not count.

    Parameters
    ----------
    calibration : rectifies the frames; None: they are rectified
    """
    from depthcli.api.matching import file_states

    files = {file for frame in frames for file in frame.input_files.values()}
    if calibration is not None:
        files |= {Path(file) for file in calibration.files}
    return _sequence_range(calibration, tuple(frames), file_states(*sorted(files)))


@lru_cache(maxsize=1)
def _sequence_range(
    calibration: Calibration | None, frames: tuple[StereoScene, ...], files: object
) -> KeyPointRange | None:
    from depthcli.api.matching import rectified_rig
    from depthcli.methods.stereo.search_range import range_of_key_points

    found: KeyPointRange | None = None
    for frame in frames:
        try:
            if calibration is None:
                pair = frame.load()
            else:
                left, right = frame.load_views()
                pair = _pair_of(rectified_rig(calibration, left, right), frame, left, right)[0]
            one = range_of_key_points(pair)
        except InputError:  # where no frame has a range, every one is on its own
            continue
        found = one if found is None else found.union(one)
    return found


def _pair_of(
    rig: RectifiedRig, scene: StereoScene, left: NDArray[np.generic], right: NDArray[np.generic]
) -> tuple[StereoPair, NDArray[np.generic]]:
    """Return the rectified pair, and its left image with the colors that the scene's has."""
    from depthcli.io.formats.images import pair_of

    views = rig.images(left, right)
    assert scene.right is not None  # it was loaded
    return pair_of(views[0], views[1], (scene.left, scene.right)), views[0]


def save_views(
    folder: Path,
    views: Mapping[str, NDArray[np.generic]],
    rig: RectifiedRig | RectifyingHomographies,
    max_disparity: int | None = None,
) -> None:
    """Write each view as ``<name>.png`` and, where ``rig`` has metric depth, ``calib.txt`` with the search range."""
    from depthcli.core.cameras.rig import RectifiedRig
    from depthcli.io.formats.calibrations import write_geometry
    from depthcli.io.formats.images import write_png

    for name, view in views.items():
        write_png(folder / f"{name}.png", view)
    if isinstance(rig, RectifiedRig):
        write_geometry(folder / "calib.txt", rig.geometry, max_disparity)


def match_rows(left: NDArray[np.generic], right: NDArray[np.generic]) -> tuple[Points, Points]:
    """Return matched key points of the images as they were taken."""
    from depthcli.methods.stereo.rectification import match_views

    return match_views(grey8(left), grey8(right))


def row_errors(points: tuple[Points, Points], rig: RectifiedRig | RectifyingHomographies) -> tuple[Row, list[str]]:
    """Return how far the rows of matched points are apart before and after, and warnings where that is too much."""
    import numpy as np

    from depthcli.core.cameras.rig import RectifiedRig
    from depthcli.methods.stereo.rectification import row_error

    moved = rig.points(*points)
    after = _rounded(row_error(*moved))
    facts = {"matches": len(points[0]), "row_error_before": _rounded(row_error(*points)), "row_error": after}
    warnings = []
    if isinstance(rig, RectifiedRig) and (after or 0) > _MAX_ROW_ERROR:
        warnings.append(
            f"the rows of half of the {len(points[0])} matched key points are still more than {after:.1f} px apart; "
            "is it the calibration of these images?"
        )
    if not isinstance(rig, RectifiedRig) and len(points[0]):
        low, high = np.quantile(moved[0][:, 0] - moved[1][:, 0], (0.05, 0.95))
        if high - low < _MIN_SPREAD:
            warnings.append(
                f"the disparities of most matched key points lie within {high - low:.1f} px: the cameras stand at one "
                "place, or see one flat thing; there is no depth to be found"
            )
    return facts, warnings


def grey8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return any image as (H, W) uint8."""
    from depthcli.core.frames import StereoPair

    return StereoPair(image, image).grey8[0]


def _rounded(value: float) -> float | None:
    import math

    return None if math.isnan(value) else round(value, 4)
