"""Archives for the benchmarks: layouts, contents, and every reason to refuse."""

import json
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.evaluation.benchmarks import BENCHMARKS, TEST, TRAINING
from depthcli.io.formats.disparity import read_disparity, write_pfm
from tests.golden import told

V3, ETH, K12, K15 = (BENCHMARKS[name] for name in ("middlebury-v3", "eth3d", "kitti-2012", "kitti-2015"))


def run_of(folder: Path, scenes: Iterable[str], size: Callable[[str], int], prefix: str = "", **facts: object) -> Path:
    """A run with a map of 3 rows a scene, 20 px and 1/256 px more from scene to scene."""
    rows = []
    for n, scene in enumerate(scenes):
        write_pfm(folder / prefix / scene / "disp_left.pfm", np.full((3, size(scene)), 20 + n / 256, np.float32))
        name = f"{prefix}/{scene}" if prefix else scene
        rows.append({"scene": name, "status": "done", "seconds": {"a": 1.0, "b": 0.25}, "width": size(scene),
                     "height": 3, **facts})  # fmt: skip
    (folder / "report.json").write_text(json.dumps({"scenes": rows}))
    return folder


def quarter(scene: str) -> int:
    return {"ArtL": 1388, "Computer": 1328, "Teddy": 1800}.get(scene, 2800) // 4


def export(run: Path, name: str, target: Path, *more: str) -> int:
    return main(["export", str(run), "--for", name, "--method", "OUR-1", "-o", str(target), "-q", *more])


def test_middlebury(tmp_path: Path):
    run = run_of(tmp_path / "run", [*V3.scenes[TRAINING], *V3.scenes[TEST]], quarter)
    assert export(run, "middlebury-v3", tmp_path / "a.zip") == 0
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert float(archive.read("testQ/Plants/timeOUR-1.txt")) == 1.25
        archive.extractall(tmp_path / "out")
    number = V3.scenes[TRAINING].index("Teddy")
    values = read_disparity(tmp_path / "out" / "trainingQ" / "Teddy" / "disp0OUR-1.pfm")
    assert np.all(values == 20 + number / 256)
    assert values.shape == (3, 450)
    # Only what was asked for; and the same bytes again.
    assert export(run, "middlebury-v3", tmp_path / "b.zip", "--split", "training") == 0
    assert len(zipfile.ZipFile(tmp_path / "b.zip").namelist()) == 30
    assert export(run, "middlebury-v3", tmp_path / "c.zip") == 0
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "c.zip").read_bytes()


def test_middlebury_refuses_with_all_reasons(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    run = run_of(tmp_path / "run", V3.scenes[TRAINING][:-1], quarter)
    values = np.full((3, 700), 5, np.float32)
    values[1, 1] = np.nan
    write_pfm(run / "Piano" / "disp_left.pfm", values)
    write_pfm(run / "Pipes" / "disp_left.pfm", np.full((3, 1400), 5, np.float32))
    write_pfm(run / "Recycle" / "disp_left.pfm", np.full((3, 700), -1, np.float32))
    (run / "Shelves" / "disp_left.pfm").write_bytes(b"no map")
    assert export(run, "middlebury-v3", tmp_path / "a.zip", "--method", "our name") == 2
    told(capsys.readouterr().err)
    assert not (tmp_path / "a.zip").exists()


def test_sparse_maps_are_named_so(tmp_path: Path):
    run = run_of(tmp_path / "run", V3.scenes[TEST], quarter, prefix="testQ")
    values = np.full((3, 700), 5, np.float32)
    values[1, 1] = np.nan
    write_pfm(run / "testQ" / "Plants" / "disp_left.pfm", values)
    assert export(run, "middlebury-v3", tmp_path / "a.zip") == 2
    assert export(run, "middlebury-v3", tmp_path / "a.zip", "--sparse") == 0
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert "testQ/Plants/disp0OUR-1_s.pfm" in archive.namelist()
        archive.extract("testQ/Plants/disp0OUR-1_s.pfm", tmp_path)
    back = read_disparity(tmp_path / "testQ/Plants/disp0OUR-1_s.pfm")
    assert np.array_equal(back, values, equal_nan=True)
    assert export(run, "middlebury-v3", tmp_path / "a.zip", "--sparse") == 2  # it is there
    assert export(run, "middlebury-v3", tmp_path / "a.zip", "--sparse", "--overwrite") == 0


@pytest.mark.parametrize(("name", "folder", "frames"), [("kitti-2012", "", 195), ("kitti-2015", "disp_0/", 200)])
def test_kitti(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, folder: str, frames: int):
    scenes = BENCHMARKS[name].scenes[TEST]
    run = run_of(tmp_path / "run", scenes, lambda scene: 12)
    assert export(run, name, tmp_path / "a.zip") == 0
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.namelist() == [f"{folder}{n:06d}_10.png" for n in range(frames)]
        (tmp_path / "7.png").write_bytes(archive.read(f"{folder}000007_10.png"))
    assert np.all(read_disparity(tmp_path / "7.png") == 20 + 7 / 256)
    write_pfm(run / scenes[3] / "disp_left.pfm", np.full((3, 12), 256, np.float32))
    write_pfm(run / scenes[4] / "disp_left.pfm", np.full((3, 12), np.nan, np.float32))
    assert export(run, name, tmp_path / "b.zip") == 2
    told(capsys.readouterr().err)


def test_kitti_takes_no_training_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    run = run_of(tmp_path / "run", K15.scenes[TEST], lambda scene: 12, source="/kitti/training/image_2/000000_10.png")
    assert export(run, "kitti-2015", tmp_path / "a.zip") == 2
    lines = capsys.readouterr().err.splitlines()
    told("\n".join(lines[:2]))
    assert len(lines) == 201 and len({line.partition(": ")[2] for line in lines[1:]}) == 1


def test_eth3d_and_maps_of_other_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    run = tmp_path / "run"
    for scene in ETH.scenes[TEST]:
        write_pfm(run / "low_res_two_view" / f"{scene}.pfm", np.full((3, 30), 7, np.float32))
    assert export(run, "eth3d", tmp_path / "a.zip") == 2
    err = capsys.readouterr().err
    assert "tunnel_1l: no run time" in err and "--seconds" in err
    assert export(run, "eth3d", tmp_path / "a.zip", "--seconds", "0.5") == 0
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert len(archive.namelist()) == 40
        assert archive.read("low_res_two_view/sand_box_1l.txt") == b"runtime 0.5\n"
    write_pfm(run / "low_res_two_view" / "tunnel_1l.pfm", np.full((3, 30), 31, np.float32))
    assert export(run, "eth3d", tmp_path / "b.zip", "--seconds", "0.5") == 2
    told(capsys.readouterr().err)
