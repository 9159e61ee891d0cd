"""What views of a board determine of a camera."""

import math

import numpy as np

from depthcli.algorithms.calibration import Chessboard, _focal_sensitivity
from depthcli.core.cameras.camera import Camera

CAMERA = Camera(np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), (0.0,) * 5)


def test_one_view_parallel_to_the_image_determines_no_focal_length():
    """The board may as well be nearer to a camera of a shorter one; all corners at one point determine nothing."""
    points = Chessboard(9, 6, 0.025).points
    ahead = np.zeros(3), np.array([-0.1, -0.06, 0.5])
    others = [(np.array(turn), ahead[1]) for turn in ((0.5, 0, 0), (0, 0.5, 0), (0.3, -0.4, 0.2))]
    assert _focal_sensitivity(CAMERA, [points], [ahead]) == math.inf
    assert _focal_sensitivity(CAMERA, [0 * points], [(np.zeros(3), np.array([0, 0, 0.5]))]) == math.inf
    assert _focal_sensitivity(CAMERA, [points] * 4, [ahead, *others]) < 0.05
