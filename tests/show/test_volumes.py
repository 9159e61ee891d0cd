"""The picture of volumes, of any size, and pictures that cannot be drawn."""

import numpy as np
import pytest

from depthcli.core.errors import OutputError
from depthcli.core.volumes import Grid
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import read_image, write_drawn
from depthcli.show.volumes import draw_volumes


@pytest.mark.parametrize(
    "shape",
    [(1, 240, 320), (1, 320, 240), (1, 30, 300), (1, 3, 300), (1, 1, 50), (1, 50, 1), (50, 1, 1), (1, 1, 1),
     (40, 1, 60), (9, 30, 1), (2, 2, 2), (12, 300, 20), (300, 12, 20)],
)  # fmt: skip
@pytest.mark.parametrize("neurological", [False, True])
def test_volumes_of_any_size_are_drawn(shape: tuple[int, int, int], neurological: bool):
    volume = np.random.default_rng(0).integers(0, 200, shape).astype(np.float32)
    maps = {"error": lambda size, corner: np.full(size, 3, np.float32)}
    grid = Grid(shape[::-1], (1.0, 1.0, 2.5))
    inside = np.ones(shape, bool)
    drawn = draw_volumes({"a": volume, "b": volume}, grid, (1, 1, 1), maps, inside, neurological)
    assert drawn.dtype == np.uint8 and drawn.shape[1] >= 900 and drawn.shape[2] == 3


def test_slices_on_white_paper_through_a_point():
    volume = np.zeros((20, 30, 40), np.float32)
    volume[5, 6, 7] = 200  # in no middle slice
    volume[0] = 100
    grid = Grid(volume.shape[::-1], (1.0, 1.0, 1.0))
    maps = {"error": lambda size, corner: np.full(size, 3, np.float32)}
    shown = volume, grid, (1, 1, 1), maps, np.zeros(volume.shape, bool), False
    dark, light, through = (
        draw_volumes({"a": shown[0]}, *shown[1:], *more) for more in ((), (True,), (True, (5, 6, 7)))
    )
    assert dark[0, 0].max() < 50 and light[0, 0].min() == 255 and light.shape == dark.shape
    bright = [int((picture[60:, :300] == 255).all(axis=2).sum()) for picture in (light, through)]
    assert bright[1] > bright[0]


def test_a_picture_that_cannot_be_drawn_is_said_and_a_full_disk_is_not_hidden(tmp_path):
    def fails() -> np.ndarray:
        raise ValueError("could not broadcast")

    with collected_warnings() as lines:
        write_drawn(tmp_path / "preview.png", fails)
        write_drawn(tmp_path / "none.png", lambda: None)
        write_drawn(tmp_path / "fine.png", lambda: np.full((3, 4, 3), 7, np.uint8))
    assert lines == ["preview.png: not written, as it cannot be drawn (ValueError: could not broadcast)"]
    assert read_image(tmp_path / "fine.png").shape == (3, 4, 3)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        write_drawn(tmp_path / "file" / "fine.png", lambda: np.zeros((3, 4, 3), np.uint8))
