"""Pairs of a calibrated rig made to correspond: what ``rectify`` and the commands that match pairs have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.batch.json_csv import Row

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.cameras.rig import RectifiedRig, Rig
    from depthcli.core.frames import StereoPair
    from depthcli.data.scenes.stereo import StereoScene
    from depthcli.methods.stereo.config import Calibration
    from depthcli.methods.stereo.rectification import Points, RectifyingHomographies

_MAX_ROW_ERROR = 1.0  # median row error of a calibrated pair, pixels; with more a scene has a warning
_MIN_SPREAD = 1.0  # of the disparities of a pair without calibration, pixels; with less a scene has a warning


def read_rig(calibration: Calibration) -> Rig:
    """Read the two cameras of a calibration; InputError where it cannot be read."""
    from depthcli.data.formats import rigs

    paths = [Path(file) for file in calibration.files]
    return rigs.read_rig(paths, calibration.unit, calibration.fisheye, calibration.cameras)


def rectified_rig(calibration: Calibration, left: NDArray[np.generic], right: NDArray[np.generic]) -> RectifiedRig:
    """Return how images of these sizes are rectified; InputError where the calibration is not theirs."""
    sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
    return read_rig(calibration).rectified(*sizes, calibration.alpha)


def rectified_pair(calibration: Calibration, scene: StereoScene, folder: Path) -> tuple[StereoPair, Row, list[str]]:
    """Rectify the scene's pair; write images and calibration into ``folder``; return facts and warnings, too.

    Raises
    ------
    InputError
        The images or the calibration cannot be used.
    """
    from depthcli.data.formats.stereo_images import pair_of

    left, right = scene.load_views()
    found = rectified_rig(calibration, left, right)
    views = found.images(left, right)
    facts, warnings = row_errors(match_rows(left, right), found)
    save_views(folder, views[0], views[1], found)
    if scene.has_truth:
        warnings.append("the map is that of the rectified image, the scene's ground truth is not: do not compare them")
    assert scene.right is not None  # it was loaded
    return pair_of(views[0], views[1], (scene.left, scene.right)), facts, warnings


def save_views(
    folder: Path,
    left: NDArray[np.generic],
    right: NDArray[np.generic],
    rig: RectifiedRig | RectifyingHomographies,
    max_disparity: int | None = None,
) -> None:
    """Write ``left.png``, ``right.png`` and, where ``rig`` has metric depth, ``calib.txt`` with the search range."""
    from depthcli.core.cameras.rig import RectifiedRig
    from depthcli.data.formats.images import write_png
    from depthcli.data.formats.pair_geometry import write_geometry

    for name, view in (("left", left), ("right", right)):
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
