"""The sheet of small pictures: a row per scene, a column per run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.protocols._disparity import DisparityTruth
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol
from depthcli.evaluation.scores import MapResult
from depthcli.io.formats.images import read_image
from depthcli.io.scenes import StereoScene
from depthcli.report.colors import map_colors
from depthcli.report.contact_sheet import ContactSheet

TRUTH = np.tile(np.linspace(1, 3, 40, dtype=np.float32), (30, 1))


def sheet_of(folder: Path, image: np.ndarray | None) -> Path:
    """Write the sheet of one scene, of which the second run alone has a map: 3 px everywhere."""
    presentation = replace(MiddleburyV2Protocol.presentation, image=lambda scene: image)
    judge, scene = MiddleburyV2Protocol(), StereoScene(name="a", folder=folder, left=folder)
    judge.presentation = presentation
    truth, sheet = DisparityTruth(TRUTH, {"all": np.ones(TRUTH.shape, bool)}), ContactSheet()
    sheet.begin(folder)
    sheet.begin_scene(judge, scene, truth)
    result = MapResult("second", "a", "set", judge.name)
    sheet.add_map(result, folder, np.full(TRUTH.shape, 3, np.float32), truth, {})
    sheet.write(EvaluationReport(("first", "second"), (result,), {}, "truth"), "", {})
    return folder / sheet.file


def test_maps_in_the_colors_of_the_truth_stand_above_their_errors(tmp_path: Path):
    made = read_image(sheet_of(tmp_path, np.full((30, 40, 3), 9, np.uint8))).astype(int)
    yellow, black = (np.argwhere(np.abs(made - color).sum(axis=2) < 10)[:, ::-1] for color in (map_colors()[-1], 0))
    assert len(black) > 100 * 180  # errors of more than 1 px
    in_column = yellow[yellow[:, 0] >= black[:, 0].min()]
    assert len(in_column) == 240 * 180  # the largest value of the truth
    assert in_column[:, 1].max() < black[:, 1].min()
    of_truth = yellow[yellow[:, 0] < black[:, 0].min()]
    assert len(of_truth) > 0
    assert of_truth[:, 1].min() >= black[:, 1].min()  # in the row of the errors, below the image


@pytest.mark.parametrize("image", [None, np.zeros((3, 4, 5), np.uint8)])
def test_nothing_to_show_writes_nothing(tmp_path: Path, image: np.ndarray | None):
    assert not sheet_of(tmp_path, image).exists()
