"""Archives for the benchmarks: layouts, contents, and every reason to refuse."""

import json
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from depthcli.evaluation.benchmarks import BENCHMARKS, TEST, TRAINING
from depthcli.io.formats.disparity import read_disparity, write_pfm
from tests.command_line import run
from tests.files import laid

V3, ETH = (BENCHMARKS[name] for name in ("middlebury-v3", "eth3d"))


def run_of(folder: Path, scenes: Iterable[str], size: Callable[[str], int], **facts: object) -> Path:
    """A run with a map of 3 rows a scene, 20 px and 1/256 px more from scene to scene."""
    rows, done = [], {"status": "done", "height": 3, "seconds": {"a": 1.0, "b": 0.25}, **facts}
    for n, scene in enumerate(scenes):
        rows.append({"scene": scene, "width": size(scene), **done})
        laid(folder / scene, {"disp_left.pfm": np.full((3, size(scene)), 20 + n / 256, np.float32)})
    return laid(folder, {"report.json": {"scenes": rows}})


def quarter(scene: str) -> int:
    return {"ArtL": 1388, "Computer": 1328, "Teddy": 1800}.get(scene, 2800) // 4


def line(run: Path, name: str, target: Path, *more: str) -> tuple[str | Path, ...]:
    return ("export", run, "--for", name, "--method", "OUR-1", "-o", target, "-q", *more)


def test_middlebury(tmp_path: Path):
    made, (a, b, c) = tmp_path / "run", (tmp_path / f"{name}.zip" for name in "abc")
    run_of(made, [*V3.scenes[TRAINING], *V3.scenes[TEST]], quarter)
    assert run(*line(made, "middlebury-v3", a)) == 0
    with zipfile.ZipFile(a) as archive:
        assert float(archive.read("testQ/Plants/timeOUR-1.txt")) == 1.25
        assert all(file.create_system == 3 and file.external_attr >> 16 == 0o644 for file in archive.infolist())
        archive.extractall(tmp_path / "out")
    values = read_disparity(tmp_path / "out" / "trainingQ" / "Teddy" / "disp0OUR-1.pfm")
    assert np.all(values == 20 + V3.scenes[TRAINING].index("Teddy") / 256) and values.shape == (3, 450)
    # Only what was asked for; and the same bytes again.
    assert run(*line(made, "middlebury-v3", b, "--split", "training")) == 0
    assert len(zipfile.ZipFile(b).namelist()) == 30
    assert run(*line(made, "middlebury-v3", c)) == 0
    assert a.read_bytes() == c.read_bytes()
    # Maps with holes are named so.
    name, values = "testQ/Plants/disp0OUR-1_s.pfm", np.full((3, 700), 5, np.float32)
    values[1, 1] = np.nan
    write_pfm(made / "Plants" / "disp_left.pfm", values)
    words = (made, "middlebury-v3", tmp_path / "s.zip")
    assert run(*line(*words)) == 2
    assert run(*line(*words, "--sparse")) == 0
    with zipfile.ZipFile(tmp_path / "s.zip") as archive:
        archive.extract(name, tmp_path)
    assert np.array_equal(read_disparity(tmp_path / name), values, equal_nan=True)
    assert run(*line(*words, "--sparse")) == 2  # it is there
    assert run(*line(*words, "--sparse", "--overwrite")) == 0


def test_middlebury_refuses_with_all_reasons(tmp_path: Path, tool):
    made = run_of(tmp_path / "run", V3.scenes[TRAINING][:-1], quarter)
    values = np.full((3, 700), 5, np.float32)
    values[1, 1] = np.nan
    wide, negative = np.full((3, 1400), 5, np.float32), np.full((3, 700), -1, np.float32)
    for name, held in {"Piano": values, "Pipes": wide, "Recycle": negative, "Shelves": b"no map"}.items():
        laid(made / name, {"disp_left.pfm": held})
    (made / "Playroom/disp_left.pfm").unlink()
    rows = json.loads((made / "report.json").read_text())["scenes"]
    rows[0] |= {"source": str(made / "Piano/left.png")}  # of another size
    rows += [rows[1] | {"scene": "again/ArtL"}, {"scene": "Vintage", "status": "failed", "error": "too dark"}]
    laid(made, {"report.json": {"scenes": rows}, "Piano/left.png": np.zeros((4, 700), np.uint8)})
    tool.told(2, *line(made, "middlebury-v3", tmp_path / "a.zip", "--method", "our name"))
    assert not (tmp_path / "a.zip").exists()


@pytest.mark.parametrize(("name", "folder", "frames"), [("kitti-2012", "", 195), ("kitti-2015", "disp_0/", 200)])
def test_kitti(tmp_path: Path, tool, name: str, folder: str, frames: int):
    scenes = BENCHMARKS[name].scenes[TEST]
    made = run_of(tmp_path / "run", scenes, lambda scene: 12)
    assert run(*line(made, name, tmp_path / "a.zip")) == 0
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.namelist() == [f"{folder}{n:06d}_10.png" for n in range(frames)]
        (tmp_path / "7.png").write_bytes(archive.read(f"{folder}000007_10.png"))
    assert np.all(read_disparity(tmp_path / "7.png") == 20 + 7 / 256)
    for scene, value in ((scenes[3], 256), (scenes[4], np.nan)):
        write_pfm(made / scene / "disp_left.pfm", np.full((3, 12), value, np.float32))
    tool.told(2, *line(made, name, tmp_path / "b.zip"))
    image = "/kitti/training/image_2/000000_10.png"
    run_of(made, scenes, lambda scene: 12, source=image)
    assert tool.err(2, *line(made, name, tmp_path / "b.zip")).count(f"made from {image}, a training image") == frames


def test_eth3d_and_maps_of_other_programs(tmp_path: Path, tool):
    made = tmp_path / "run" / "low_res_two_view"
    for scene in ETH.scenes[TEST]:
        write_pfm(made / f"{scene}.pfm", np.full((3, 30), 7, np.float32))
    err = tool.err(2, *line(made.parent, "eth3d", tmp_path / "a.zip"))
    assert "tunnel_1l: no run time" in err and "--seconds" in err
    assert run(*line(made.parent, "eth3d", tmp_path / "a.zip", "--seconds", "0.5")) == 0
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert len(archive.namelist()) == 40
        assert archive.read("low_res_two_view/sand_box_1l.txt") == b"runtime 0.5\n"
    write_pfm(made / "tunnel_1l.pfm", np.full((3, 30), 31, np.float32))
    tool.told(2, *line(made.parent, "eth3d", tmp_path / "b.zip", "--seconds", "0.5"))
