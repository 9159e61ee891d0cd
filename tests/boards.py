"""Photos of boards by cameras that are known: what a calibration has to find."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np

from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import Rig

SIZE = (640, 480)
SQUARE = 0.025
_PX = 48  # of the texture, a square
_SUB = 3  # rays a pixel, in x and in y


def chessboard(columns: int, rows: int) -> np.ndarray:
    """The texture of a board with that many inner corners, a light margin of one square around it."""
    y, x = np.mgrid[: rows + 1, : columns + 1]
    squares = np.where((x + y) % 2, 230, 25).astype(np.uint8)
    return np.pad(np.kron(squares, np.ones((_PX, _PX), np.uint8)), _PX, constant_values=230)


def charuco(columns: int, rows: int, marker: float, dictionary: int = cv2.aruco.DICT_4X4_50) -> np.ndarray:
    """The texture of a ChArUco board of that many squares, a light margin of one square around it."""
    board = cv2.aruco.CharucoBoard((columns, rows), SQUARE, marker, cv2.aruco.getPredefinedDictionary(dictionary))
    image = board.generateImage((columns * _PX, rows * _PX), marginSize=0)
    return np.pad(image // 255 * 205 + 25, _PX, constant_values=230).astype(np.uint8)


def rig(fisheye: bool = False) -> Rig:
    lens = (0.03, -0.01, 0.004, -0.001) if fisheye else (-0.2, 0.06, 0.0008, -0.0006, 0.0)
    left, right = (
        Camera(np.array([[f, 0, cx], [0, f * 1.002, cy], [0, 0, 1]]), lens, SIZE, fisheye)
        for f, cx, cy in ((520.0, 322.5, 236.0), (527.0, 316.0, 243.5))
    )
    turn = cv2.Rodrigues(np.radians([0.8, -1.5, 0.6]))[0]
    return Rig(left, right, turn, turn @ np.array([-0.12, 0.002, -0.003]))


@cache
def _rays(matrix: bytes, lens: tuple[float, ...], fisheye: bool) -> np.ndarray:
    camera = Camera(np.frombuffer(matrix).reshape(3, 3), lens, SIZE, fisheye)
    step = (np.arange(_SUB) + 0.5) / _SUB - 0.5
    x, y = (np.arange(n)[:, None] + step for n in SIZE)
    grid = np.stack(np.meshgrid(x.ravel(), y.ravel()), -1).reshape(-1, 2)
    return camera.rays(grid).reshape(SIZE[1] * _SUB, SIZE[0] * _SUB, 2).astype(np.float32)


def photo(camera: Camera, texture: np.ndarray, turn: np.ndarray, shift: np.ndarray, noise: int = 0) -> np.ndarray:
    """(H, W) uint8 of a board whose first corner lies at ``shift`` in the camera's frame, turned by ``turn``."""
    rays = _rays(camera.matrix.tobytes(), camera.distortion, camera.fisheye)
    inverse = np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], shift]))
    on_board = np.diag([_PX / SQUARE, _PX / SQUARE, 1]) @ inverse
    on_board[:2] += (2 * _PX - 0.5) * on_board[2]
    place = cv2.transform(rays, on_board.astype(np.float32))
    u, v = (np.where(place[..., 2] > 0, place[..., k] / place[..., 2], np.float32(-1)) for k in (0, 1))
    fine = cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(120,))
    image = cv2.resize(fine.astype(np.float32), SIZE, interpolation=cv2.INTER_AREA)
    image += np.random.default_rng(noise).normal(0, 2, image.shape)
    return np.rint(image).clip(0, 255).astype(np.uint8)


def poses(n: int, extent: tuple[float, float], far: float = 0.5, tilt: float = 32.0, seed: int = 0):
    """Rotations and places of a board of ``extent`` meters that fill the view of both cameras."""
    rng = np.random.default_rng(seed)
    for k in range(n):
        angles = rng.uniform(-tilt, tilt, 3) * (1, 1, 0.4)
        turn = cv2.Rodrigues(np.radians(angles))[0]
        z = far * rng.uniform(0.75, 1.25)
        reach = np.array([0.22, 0.16]) * z / far * (0.6 if k % 2 else 1.0)
        x, y = rng.uniform(-1, 1, 2) * reach
        middle = np.array([x + 0.06, y, z])
        yield turn, middle - turn @ np.array([*extent, 0]) / 2


def pair(taken: Rig, texture: np.ndarray, turn: np.ndarray, shift: np.ndarray, noise: int = 0):
    """The photos of both cameras."""
    left = photo(taken.left, texture, turn, shift, noise)
    moved = taken.rotation @ turn, taken.rotation @ shift + taken.translation
    return left, photo(taken.right, texture, *moved, noise + 1000)


def opencv(file: Path, taken: Rig, names: str = "K1 D1 K2 D2 R T", unit: float = 1.0) -> Path:
    """Write a rig as OpenCV does, and return the file."""
    values = (
        taken.left.matrix, taken.left.coefficients, taken.right.matrix, taken.right.coefficients, taken.rotation,
        taken.translation[:, None] / unit, np.array(taken.left.size or (0, 0), np.int32),
    )  # fmt: skip
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    for name, value in zip(names.split(), values, strict=False):
        storage.write(name, value)
    storage.release()
    return file
