"""Pairs of a calibrated rig made to correspond: what ``rectify`` and the commands that match pairs have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.cameras.stereo_rig import RectifiedRig
    from depthcli.core.frames import StereoPair
    from depthcli.data.scenes.stereo import StereoScene
    from depthcli.methods.stereo.config import Calibration
    from depthcli.methods.stereo.rectification import Points

_DOUBTFUL = 1.0  # median row error of a calibrated pair above which a scene says so, pixels
_FLAT = 1.0  # spread of the disparities below which a pair without calibration says so, pixels


def calibration_files(calibration: Calibration | None) -> dict[str, Path]:
    """Role -> file, of what a result depends on."""
    return {} if calibration is None else {f"calibration_{k}": Path(f) for k, f in enumerate(calibration.files)}


def rectified_rig(calibration: Calibration, left: NDArray[Any], right: NDArray[Any]) -> RectifiedRig:
    """How images of these sizes are rectified; InputError where the calibration cannot be read or is not theirs."""
    from depthcli.data.formats.stereo_rig import read_stereo_rig

    sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
    paths = [Path(file) for file in calibration.files]
    rig = read_stereo_rig(paths, calibration.unit, calibration.fisheye, calibration.cameras)
    return rig.rectified(*sizes, calibration.alpha)


def rectified_pair(
    calibration: Calibration, scene: StereoScene, folder: Path
) -> tuple[StereoPair, dict[str, Any], list[str]]:
    """An item's images rectified, and written with their calibration into ``folder``; facts and warnings for its row.

    Raises
    ------
    InputError
        The images or the calibration cannot be used.
    """
    from depthcli.data.formats.images import pair_of

    left, right = scene.load_views()
    found = rectified_rig(calibration, left, right)
    views = found.images(left, right)
    save_views(folder, views[0], views[1], found)
    facts, warnings = row_errors(match_rows(left, right), found)
    if scene.has_truth:
        warnings.append("the map is that of the rectified image, the scene's ground truth is not: do not compare them")
    assert scene.right is not None  # it was loaded
    return pair_of(views[0], views[1], (scene.left, scene.right)), facts, warnings


def save_views(folder: Path, left: NDArray[Any], right: NDArray[Any], rig: Any, top: int | None = None) -> None:
    """``left.png``, ``right.png`` and, where ``rig`` has metric depth, ``calib.txt`` with the search range."""
    from depthcli.core.cameras.stereo_rig import RectifiedRig
    from depthcli.data.formats.calibration import write_geometry
    from depthcli.data.formats.images import write_png

    for name, view in (("left", left), ("right", right)):
        write_png(folder / f"{name}.png", view)
    if isinstance(rig, RectifiedRig):
        write_geometry(folder / "calib.txt", rig.geometry, top)


def match_rows(left: NDArray[Any], right: NDArray[Any]) -> tuple[Points, Points]:
    """Matched key points of the images as they were taken."""
    from depthcli.methods.stereo.rectification import match_views

    return match_views(grey8(left), grey8(right))


def row_errors(points: tuple[Points, Points], rig: Any) -> tuple[dict[str, Any], list[str]]:
    """How far the rows of matched points are apart before and after, and a warning where that is too much."""
    import numpy as np

    from depthcli.core.cameras.stereo_rig import RectifiedRig
    from depthcli.methods.stereo.rectification import row_error

    moved = rig.points(*points)
    after = _rounded(row_error(*moved))
    facts = {"matches": len(points[0]), "row_error_before": _rounded(row_error(*points)), "row_error": after}
    warnings = []
    if isinstance(rig, RectifiedRig) and (after or 0) > _DOUBTFUL:
        warnings.append(
            f"the rows of half of the {len(points[0])} matched key points are still more than {after:.1f} px apart; "
            "is it the calibration of these images?"
        )
    if not isinstance(rig, RectifiedRig) and len(points[0]):
        low, high = np.quantile(moved[0][:, 0] - moved[1][:, 0], (0.05, 0.95))
        if high - low < _FLAT:
            warnings.append(
                f"the disparities of most matched key points lie within {high - low:.1f} px: the cameras stand at one "
                "place, or see one flat thing; there is no depth to be found"
            )
    return facts, warnings


def suggested_range(pair: StereoPair) -> dict[str, int]:
    """``min_disparity`` and ``max_disparity`` by matched key points; InputError where too few match."""
    from depthcli.methods.stereo.search_range import range_of_key_points

    search, _ = range_of_key_points(pair)
    return {"min_disparity": min(search.low, 0), "max_disparity": max(search.top, 1)}


def grey8(image: Any) -> NDArray[np.uint8]:
    """(H, W) uint8 of any image."""
    from depthcli.core.frames import StereoPair

    return StereoPair(image, image).grey8[0]


def _rounded(value: float) -> float | None:
    import math

    return None if math.isnan(value) else round(value, 4)
