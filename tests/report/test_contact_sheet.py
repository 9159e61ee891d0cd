"""The sheet of small pictures: a row per scene, a column per run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from depthcli.io.formats.images import read_image
from depthcli.report.colors import map_colors
from depthcli.report.contact_sheet import ContactSheet

GREEN = np.full((30, 40, 3), (0, 255, 0), np.uint8)
TRUTH = np.tile(np.linspace(1, 3, 40, dtype=np.float32), (30, 1))


def test_maps_in_the_colors_of_the_truth_stand_above_their_errors(tmp_path: Path):
    sheet = ContactSheet(["first", "second"])
    sheet.begin_scene("a", np.full((30, 40, 3), 9, np.uint8), TRUTH)
    sheet.add_map("a", "second", np.full((30, 40), 3, np.float32), GREEN)
    sheet.begin_scene("volume", np.zeros((3, 4, 5), np.uint8), None)  # no picture: no row
    sheet.add_map("volume", "first", TRUTH, GREEN)
    assert sheet.write(tmp_path / "sheet.png")
    made = read_image(tmp_path / "sheet.png").astype(int)
    yellow, green = (
        np.argwhere(np.abs(made - color).sum(axis=2) < 10)[:, ::-1] for color in (map_colors()[-1], GREEN[0, 0])
    )
    assert len(green) == 240 * 180
    in_column = yellow[yellow[:, 0] >= green[:, 0].min()]
    assert len(in_column) == 240 * 180  # the largest value of the truth
    assert in_column[:, 1].max() < green[:, 1].min()
    of_truth = yellow[yellow[:, 0] < green[:, 0].min()]
    assert len(of_truth) > 0
    assert of_truth[:, 1].min() >= green[:, 1].min()  # in the row of the errors, below the image


def test_nothing_to_show_writes_nothing(tmp_path: Path):
    sheet = ContactSheet(["run"])
    sheet.begin_scene("a", None, TRUTH)
    assert not sheet.write(tmp_path / "sheet.png")
    assert not list(tmp_path.iterdir())
