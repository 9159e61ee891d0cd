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
