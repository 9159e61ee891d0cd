"""What a camera and a rig are: impossible ones are refused, and distances along rays are kept."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import Rig
from depthcli.core.errors import InputError

MATRIX = np.array([[190.0, 0, 98], [0, 192, 77], [0, 0, 1]])
CAMERA = Camera(MATRIX, (0.05, -0.03, 0.001, -0.001, 0.0))


@pytest.mark.parametrize(
    ("matrix", "distortion", "fisheye", "said"),
    [
        (np.zeros((3, 3)), (0,) * 5, False, "positive focal lengths"),
        (np.full((3, 3), np.nan), (0,) * 5, False, "finite 3 x 3"),
        (np.ones((3, 3)), (0,) * 5, False, "singular"),
        (MATRIX, (0.1, 0.2), False, "4, 5, 8, 12, 14 coefficients"),
        (MATRIX, (0,) * 5, True, "fisheye lens has 4 coefficients"),
        (MATRIX, (0, 0, 0, np.inf), False, "coefficients"),
    ],
)
def test_impossible_cameras_are_refused(matrix, distortion, fisheye, said):
    with pytest.raises(InputError, match=said):
        Camera(matrix, distortion, None, fisheye)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rotation": 2 * np.eye(3)}, "not a rotation"),
        ({"rotation": -np.eye(3)}, "not a rotation"),
        ({"rotation": np.eye(2)}, "want R"),
        ({"translation": np.zeros(3)}, "at one place"),
        ({"translation": np.array([np.nan, 0, 0])}, "at one place"),
        ({"right": Camera(MATRIX, (0,) * 4, None, True)}, "cannot be rectified together"),
    ],
)
def test_impossible_rigs_are_refused(changes, said):
    values = {"left": CAMERA, "right": CAMERA, "rotation": np.eye(3), "translation": np.array([-0.1, 0, 0])}
    with pytest.raises(InputError, match=said):
        Rig(**{**values, **changes})


def test_a_camera_sees_a_point_on_the_ray_of_its_pixel_and_of_two_the_nearer_one():
    pixels = np.array([[20.0, 30.0], [150.0, 100.0]])
    points = np.column_stack([CAMERA.rays(pixels), np.ones(2)])
    cloud = np.concatenate([points, 2 * points, -points])
    depth, values = CAMERA.depth_image(cloud, (150, 200), np.arange(6, dtype=np.float32))
    expected = np.full((150, 200), np.nan, np.float32)
    expected[[30, 100], [20, 150]] = 1
    np.testing.assert_array_equal(depth, expected)
    assert (values[30, 20], values[100, 150]) == (0, 1)
