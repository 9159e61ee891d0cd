"""The page and the sheet of small pictures as files: what stands in them without a browser."""

import base64
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from depthcli.core.volumes import Grid
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.evaluate import Choices, ScoredMap, evaluate_runs, scenes_with_truth
from depthcli.evaluation.protocols._disparity import DisparityTruth
from depthcli.evaluation.protocols.middlebury_v2 import MiddleburyV2Protocol
from depthcli.evaluation.protocols.registration import PreparedTruth, RegistrationProtocol
from depthcli.evaluation.scores import MapResult
from depthcli.io.formats.disparity import read_disparity, read_pfm
from depthcli.io.formats.images import read_image
from depthcli.io.formats.volumes import read_volume
from depthcli.io.scenes import Scene, StereoScene
from depthcli.io.volume_pairs import RegistrationTruth
from depthcli.report.contact_sheet import ContactSheet, _bar
from depthcli.report.packing import pack, pack_bytes, thinned, unpack
from depthcli.report.page import Page, _bars
from depthcli.report.scene_view import slices
from depthcli.show.view import WRONG, kind_colors, map_colors
from tests.golden import Same, svg_words
from tests.report.conftest import SHAPE


class Reader(HTMLParser):
    """The page of a folder: text of scripts by id, cells of tables, sources of pictures, targets of links, ids."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.scripts: dict[str, str] = {}
        self.tables: list[list[list[str]]] = []
        self.images, self.links, self.ids, self.open = list[str](), list[str](), list[str](), list[str]()
        self.text = self.script = ""
        self.feed((folder / "report.html").read_text("utf-8"))
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        for wanted, name, seen in ((tag, "id", self.ids), ("img", "src", self.images), ("a", "href", self.links)):
            if tag == wanted and name in found:
                seen.append(found[name])
        if tag == "script":
            self.script = found.get("id", f"code-{len(self.scripts)}")
            self.scripts[self.script] = ""
            assert "src" not in found
        elif tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("th", "td"):
            self.tables[-1][-1].append("")
        if tag not in ("img", "meta", "input", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] == ["script"]:
            self.scripts[self.script] += data
            return
        if "style" not in self.open:
            self.text += data
        if "table" in self.open and self.open[-1] in ("a", "th", "td") and self.tables[-1]:
            self.tables[-1][-1][-1] += data

    def scenes(self) -> list[dict[str, Any]]:
        return [json.loads(self.scripts[f"data-{k}"]) for k in range(len(self.scripts)) if f"data-{k}" in self.scripts]


def test_bars_of_negative_headlines():
    assert _bars({"a": 0.5, "b": -0.5, "c": math.nan}) == {"a": 100, "b": 0, "c": 0}
    assert _bars({"a": -0.5, "b": -0.25}) == {"a": 0, "b": 0}


def test_everything_is_in_the_file_and_nothing_else(made: Path, same: Same):
    page = Reader(made)
    assert set(page.scripts) == {"page", "scores", "data-0", "data-1", "code-4", "code-5"}  # a name is no script
    assert json.loads(page.scripts["scores"]) == json.loads((made / "scores.json").read_text())
    same("page.txt", "\n".join(line.strip() for line in page.text.splitlines() if line.strip()))
    same("page.plots.txt", "\n".join(svg_words(file) for file in sorted(made.rglob("*.svg"))))
    same("page.files.txt", "\n".join(sorted(path.relative_to(made).as_posix() for path in made.rglob("*"))))
    same("page.report.md", (made / "report.md").read_text("utf-8"))
    assert not (made / "assets").exists()
    assert all(source.startswith("data:image/") for source in page.images)
    assert len(page.images) > 2 * 2 * 2 + 3  # maps and errors of two runs and scenes, and plots
    assert {link[1:].partition("/")[0] for link in page.links} <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    text = (made / "report.html").read_text("utf-8")
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", text)


def test_maps_come_back_as_they_were(made: Path, runs: list[Path]):
    (scene,) = (scene for scene in Reader(made).scenes() if scene["name"] == "plain")
    (view,) = scene["views"]
    assert (view["height"], view["width"]) == SHAPE
    for run in runs:
        packed = view["runs"][run.name]
        values, exact = unpack(packed["values"]), read_disparity(run / "plain" / "disp_left.pfm")
        assert np.array_equal(np.isnan(values), np.isnan(exact))
        step = packed["values"]["step"]
        assert step < 1e-3
        inside = (values > 2) & (values < 14)
        assert np.nanmax(np.abs(values - exact)[inside]) <= step / 2 + 1e-6
        assert packed["error"] is None  # the difference of the two
    bound, packed = read_pfm(runs[0] / "plain" / "bound.pfm"), view["runs"][runs[0].name]["bound"]
    assert np.allclose(unpack(packed)[bound < np.inf], bound[bound < np.inf], atol=packed["step"])
    assert np.all(unpack(packed)[bound == np.inf] > 4 * bound[bound < np.inf].max())  # shown as above the scale
    assert view["runs"][runs[1].name]["bound"] is None
    low, high = scene["bound"]
    assert 0 < low < np.median(bound) < high <= bound[bound < np.inf].max()
    region = unpack(view["region"])
    known, occluded = region & 1 > 0, region & 2 > 0
    assert np.array_equal(known[:, :8], ~np.isnan(unpack(view["truth"]))[:, :8])
    assert np.array_equal(occluded[:, :8], known[:, :8]) and not occluded[:, 8:].any()


@pytest.mark.slow
def test_beyond_the_budget_pictures_shrink_and_full_ones_lie_beside(tmp_path: Path, scenes: Path, runs: list[Path]):
    output = tmp_path / "out"
    evaluate_runs(runs, scenes_with_truth(scenes), scenes, output, Choices(viewers=[Page(budget=2000)]))
    page = Reader(output)
    assert "of their size" in page.text
    view = page.scenes()[1]["views"][0]
    full = (output / "assets" / "scene-1.js").read_text()
    data = json.loads(full[full.index("{") : full.rindex("}") + 1])["views"][0]
    factor = view["factor"]
    assert factor > 1 and view["height"] == -(-SHAPE[0] // factor)
    assert (data["height"], data["factor"]) == (SHAPE[0], 1)
    for name in ("good", 'bad "<b>"'):
        small, large = (unpack(v["runs"][name]["values"]) for v in (view, data))
        assert np.array_equal(small, large[::factor, ::factor], equal_nan=True)
    evaluate_runs(runs, scenes_with_truth(scenes), scenes, output, Choices(viewers=[Page()]))
    assert not (output / "assets").exists()


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-7.5, 200.3), (500.0, 9000.0), (3.0, 3.0)])
def test_packing(low: float, high: float):
    rng = np.random.default_rng(3)
    values = rng.uniform(low, high, (7, 5))
    values[2, 3], values[0, 0], values[-1, -1] = np.nan, low, high
    packed = pack(values, low, high)
    back = unpack(packed)
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values)) <= packed["step"] / 2 + 1e-12
    assert packed["step"] <= 2 * max(high - low, 1e-6) / 65000
    outside = unpack(pack(np.array([[-np.inf, low - 1e9, high + 1e9, np.inf]]), low, high))
    assert outside[0, 0] == outside[0, 1] < low
    assert outside[0, 2] == outside[0, 3] > high
    assert np.array_equal(unpack(thinned(packed, 2)), back[::2, ::2], equal_nan=True)
    bits = rng.integers(0, 256, (4, 6)).astype(np.uint8)
    assert np.array_equal(unpack(pack_bytes(bits)), bits)


class Shifted(RegistrationProtocol):
    """Errors that are no difference of values and truth."""

    def error(self, estimate: Any, truth: Any) -> Any:
        return estimate + 1


class WithoutGrid(Shifted):
    presentation = replace(RegistrationProtocol.presentation, on_grid=lambda *_: None)


@pytest.mark.parametrize("kind", [Shifted, WithoutGrid])
def test_points_show_where_they_lie_on_a_grid(tmp_path: Path, kind: type[RegistrationProtocol]):
    judge, scene, page, grid = kind(), Scene(name="box", folder=tmp_path), Page(), Grid((8, 6, 4), (1, 1, 1))
    inside = np.zeros((4, 6, 8), bool)
    inside[1:3, 2:, ::2] = True
    points = np.arange(inside.sum(), dtype=np.float32) / 8
    truth = registration_truth(points * 2, grid, None, inside)
    result = MapResult("run", "box", "set", judge.name, scores=tuple(judge.scores(points, truth)))
    page.begin(tmp_path)
    page.begin_scene(judge, scene, truth)
    page.add_map(ScoredMap(result, tmp_path / "box", points, truth, {"c": points}, points))
    page.write(EvaluationReport(("run",), (result,), {judge.name: judge}, "truth"), "{}", {})
    reader = Reader(tmp_path)
    assert "1 run, 1 scene of" in reader.text
    if kind is WithoutGrid:
        assert reader.scenes() == []
        return
    (data,) = reader.scenes()
    views, parts = data["views"], [f"{k + 1} of {n}" for n in (4, 6, 8) for k in range(n)]
    assert [view["name"].rpartition(", ")[2] for view in views] == parts
    full = np.full(inside.shape, np.nan)
    full[inside] = points + 1
    shown, view = grid.turned(full)[2], views[2]
    assert np.array_equal(unpack(view["region"]) > 0, ~np.isnan(shown))
    assert np.allclose(unpack(view["runs"]["run"]["error"]), shown, atol=0.01, equal_nan=True)


def test_volumes_are_cut_across_every_axis():
    volume = np.arange(4 * 6 * 8).reshape(4, 6, 8)
    every = slices(volume.shape)
    assert [volume[cut.index].shape for cut in every] == [(6, 8)] * 4 + [(4, 8)] * 6 + [(4, 6)] * 8
    assert np.array_equal(volume[every[7].index], volume[:, 3])
    few = slices(volume.shape, max_pixels=volume.size)
    assert [(cut.axis, cut.place) for cut in few] == [(0, 2), (1, 0), (1, 3), (2, 1), (2, 4), (2, 7)]
    assert {cut.axis for cut in slices((1, 6, 8))} == {0}
    assert [cut.axis for cut in slices((3, 4))] == [-1]


def registration_truth(error: np.ndarray, grid: Grid, places: np.ndarray | None, inside: np.ndarray | None):
    points = np.zeros((0, 3)) if places is None else grid.to_point(places)
    return PreparedTruth(error, places, inside, RegistrationTruth(grid, points, error))


def test_landmarks_are_balls_in_their_volume():
    grid = Grid((128, 96, 40), (1.0, 1.0, 2.0), (5.0, 6.0, 7.0))
    judge, error = RegistrationProtocol(), np.array([1, 2, 3], np.float32)
    places = np.array([[20.2, 30.0, 40.4], [0, 0, 0], [20.2, 30.0, 42.0]])  # z, y, x; one at a corner
    truth = registration_truth(error, grid, places, None)
    volume = judge.presentation.on_grid(error, truth)[::-1]  # it is shown from superior to inferior
    z, y, x = np.indices(volume.shape)
    balls = [np.hypot(np.hypot(2 * (z - k), y - i), x - j) <= 2.0 for k, i, j in np.rint(places)]
    for near, value in zip(balls[:2], error[:2], strict=True):
        assert set(np.unique(volume[near])) <= {value, error[2]}
    assert (volume[20, 30, 42], volume[20, 30, 38]) == (3, 1)
    np.testing.assert_array_equal(~np.isnan(volume), np.any(balls, axis=0))
    axes = judge.presentation.axes(truth)
    assert [(axis.plane, axis.ends) for axis in axes] == [("axial", "SI"), ("coronal", "AP"), ("sagittal", "RL")]
    assert [(axis.first, axis.step) for axis in axes] == [(7 + 39 * 2, -2), (-6, -1), (-5, -1)]


def test_slices_show_the_fixed_volume_beneath(volumes: Path):
    (data,) = Reader(volumes).scenes()
    assert data["opacity"] < 1
    view = data["views"][data["start"]]
    (name,) = view["runs"]
    code = base64.b64decode(view["image"].partition(",")[2])
    picture = cv2.imdecode(np.frombuffer(code, np.uint8), cv2.IMREAD_GRAYSCALE).astype(float)
    assert picture.shape == (view["height"], view["width"])
    fixed = read_volume(volumes.parent / "set" / "pair_0" / "fixed.nii.gz")
    fixed = fixed.grid.turned(fixed.values)[data["start"]]
    assert np.corrcoef(picture.ravel(), np.clip(fixed, *np.percentile(fixed, (1, 99))).ravel())[0, 1] > 0.98
    known = unpack(view["region"]) > 0
    assert not known.all()  # the image shows through around the mask
    assert np.array_equal(~np.isnan(unpack(view["runs"][name]["values"])), known)
    assert data["words"][2] == "true error above 3 mm"


TRUTH = np.tile(np.linspace(1, 3, 40, dtype=np.float32), (30, 1))


def sheet_of(folder: Path, image: np.ndarray | None, maps: dict[str, dict[str, float]] | None = None) -> ContactSheet:
    """Write the sheet of scenes with maps of one value each; of one scene, the second run alone has a map: 3 px."""
    judge = MiddleburyV2Protocol()
    judge.presentation = replace(judge.presentation, image=lambda scene: image)
    truth, sheet, results = DisparityTruth(TRUTH, {"all": np.ones(TRUTH.shape, bool)}), ContactSheet(), []
    sheet.begin(folder)
    for name, of_runs in (maps or {"a": {"second": 3.0}}).items():
        sheet.begin_scene(judge, StereoScene(name=name, folder=folder, left=folder), truth)
        for run, value in of_runs.items():
            values = np.full(TRUTH.shape, value, np.float32)
            results.append(MapResult(run, name, "set", judge.name, scores=tuple(judge.scores(values, truth))))
            sheet.add_map(ScoredMap(results[-1], folder, values, truth, {}))
    sheet.write(EvaluationReport(("first", "second"), tuple(results), {}, "truth"), "", {})
    return sheet


def test_maps_in_the_colors_of_the_truth_stand_above_their_errors(tmp_path: Path):
    sheet_of(tmp_path, np.full((30, 40, 3), 9, np.uint8))
    made = read_image(tmp_path / "contact_sheet.png").astype(int)
    colors = (map_colors()[-1], kind_colors()[WRONG])
    yellow, wrong = (np.argwhere(np.abs(made - color).sum(axis=2) < 10)[:, ::-1] for color in colors)
    errors = wrong[wrong[:, 0] > 248]  # of more than 1 px; the legend has the color, too
    assert len(wrong) > len(errors) > 100 * 180
    left, top = errors.min(axis=0)
    in_column = yellow[yellow[:, 0] >= left]
    assert len(in_column) == 240 * 180  # the largest value of the truth
    assert in_column[:, 1].max() < top
    of_truth = yellow[yellow[:, 0] < left]
    assert len(of_truth) > 0 and of_truth[:, 1].min() >= top  # in the row of the errors, below the image
    assert (_bar(0.0, 9.0, "px")[2:12, [0, -1]] == np.asarray(map_colors())[[0, -1]]).all()


def test_the_scenes_that_differ_most_are_shown(tmp_path: Path):
    """Shares of wrong pixels for maps of 2, 1.5 and 3 px: 0, about a quarter and a half."""
    same = {f"same{k}": {"first": 3.0, "second": 3.0} for k in range(6)}
    more = {"half": {"first": 2.0, "second": 3.0}, "less": {"first": 2.0, "second": 2.5}}
    sheet = sheet_of(tmp_path, np.full((30, 40, 3), 9, np.uint8), same | more | {"x": {"first": 2.0, "second": 2.0}})
    assert [row.scene for row in sheet._rows] == ["half", "less", "same0", "same1"]


@pytest.mark.parametrize("image", [None, np.zeros((3, 4, 5), np.uint8)])
def test_nothing_to_show_writes_nothing(tmp_path: Path, image: np.ndarray | None):
    sheet_of(tmp_path, image)
    assert not (tmp_path / "contact_sheet.png").exists()
