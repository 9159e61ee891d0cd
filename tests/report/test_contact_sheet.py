"""The sheet of small pictures: a row per scene, a column per run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from depthcli.data.formats.images import read_image, write_png
from depthcli.report.contact_sheet import ContactSheet

RED, GREEN = (np.full((30, 40, 3), color, np.uint8) for color in ((255, 0, 0), (0, 255, 0)))


def test_maps_stand_above_their_errors_in_the_column_of_the_run(tmp_path: Path):
    sheet = ContactSheet(["first", "second"])
    for run in ("first", "second"):
        write_png(tmp_path / run / "preview.png", RED)
    sheet.begin_scene("a", np.full((30, 40, 3), 9, np.uint8))
    sheet.add_map("a", "second", tmp_path / "second" / "map.pfm", GREEN)
    sheet.begin_scene("volume", np.zeros((3, 4, 5), np.uint8))  # no picture: no row
    sheet.add_map("volume", "first", tmp_path / "first" / "map.pfm", GREEN)
    assert sheet.write(tmp_path / "sheet.png")
    made = read_image(tmp_path / "sheet.png").astype(int)
    red, green = (np.argwhere(np.abs(made - color[0, 0]).sum(axis=2) < 10) for color in (RED, GREEN))
    assert len(red) == len(green) == 240 * 180
    assert red[:, 0].max() < green[:, 0].min()
    assert set(red[:, 1]) == set(green[:, 1])
    assert red[:, 1].min() > 240  # behind the image


def test_nothing_to_show_writes_nothing(tmp_path: Path):
    sheet = ContactSheet(["run"])
    sheet.begin_scene("a", None)
    assert not sheet.write(tmp_path / "sheet.png")
    assert not list(tmp_path.iterdir())
