"""Programs as methods of ``register-confidence``: their volumes, every failure as a row, resuming, workers."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import depthcli
from depthcli.cli import main
from depthcli.core.volumes import Grid
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.methods.registration.config import RegisterConfidenceConfig
from depthcli.methods.registration.pipeline.search import RegistrationSearch
from tests.programs._runs import assert_one_failed, rows

pytest.importorskip("SimpleITK")

# The difference of both volumes is the error, but for one scene it fails in the way that its argument says.
PROGRAM = """
import sys
import SimpleITK as sitk
fixed, warped, output, name, kind = sys.argv[1:]
fixed, warped = (sitk.ReadImage(file) for file in (fixed, warped))
error = sitk.Abs(fixed - warped) / 100
if name == "pair_1":
    if kind == "missing":
        sys.exit()
    if kind == "empty":
        open(output, "wb")
        sys.exit()
    if kind == "crashes":
        sys.exit("no license")
    if kind == "rubbish":
        open(output, "wb").write(b"rubbish" * 100)
        sys.exit()
    if kind == "size":
        error = error[:-1]
    if kind == "place":
        error.SetOrigin((5, 0, 0))
    if kind == "nan":
        error[3, 4, 5] = float("nan")
    if kind == "negative":
        error[3, 4, 5] = -1
sitk.WriteImage(error, output)
"""
FAILURES = {
    "missing": "the program wrote no output.nii.gz; its files are in ",
    "empty": "the program wrote an empty output.nii.gz",
    "crashes": "ended with exit code 1: no license",
    "rubbish": "the program's volume cannot be read: ",
    "size": "output.nii.gz lies on another grid than the fixed volume (size 55 x 56 x 40, want 56 x 56 x 40)",
    "place": "output.nii.gz lies on another grid than the fixed volume (origin 5 0 0, want ",
    "nan": "1 voxels of the program's output.nii.gz are NaN or infinite; want mm",
    "negative": "1 voxels of the program's output.nii.gz are negative; want mm",
}


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pairs; the first has a landmark."""
    folder = tmp_path_factory.mktemp("pairs")
    assert main(["sample", "--registration", "-o", str(folder), "-n", "2", "-q"]) == 0
    point = read_volume(folder / "pair_0" / "fixed.nii.gz").grid.to_point(np.array([[20.0, 25.0, 30.0]]))
    np.savetxt(folder / "pair_0" / "landmarks_fixed.csv", point, delimiter=",", header="x,y,z", comments="")
    return folder


@pytest.fixture
def here(here: Path) -> Path:
    """The current folder, with the program and its config in it."""
    (here / "difference.py").write_text(PROGRAM)
    words = [sys.executable, "difference.py", "{fixed}", "{warped}", "{output}", "{name}", "{kind}"]
    config = {"pipeline": "command", "run": words, "parameters": {"kind": "works"}}
    (here / "c.yaml").write_text(json.dumps(config))
    return here


def register(pairs: Path, output: str, *options: str) -> int:
    return main(["register-confidence", "c.yaml", "-i", str(pairs), "-o", output, *options])


@pytest.mark.slow
def test_a_volume_of_errors_becomes_confidence_preview_and_points(here: Path, pairs: Path, capsys):
    assert register(pairs, "run") == 0
    assert "at border" in capsys.readouterr().out
    files = {path.name for path in (here / "run" / "pair_0").iterdir()}
    assert files == {"confidence.nii.gz", "expected_error.nii.gz", "preview.png", "points.csv", "record.json"}
    scene = here / "run" / "pair_0"
    fixed, warped = (read_volume(pairs / "pair_0" / f"{name}.nii.gz") for name in ("fixed", "moving_warped"))
    error, confidence = (read_volume(scene / f"{name}.nii.gz") for name in ("expected_error", "confidence"))
    np.testing.assert_allclose(error.values, np.abs(fixed.values - warped.values) / 100, atol=1e-6)
    np.testing.assert_allclose(confidence.values, np.exp(-error.values / 3), rtol=1e-5)
    assert error.grid.same_as(fixed.grid)
    head, line = (scene / "points.csv").read_text().splitlines()
    assert head == "x,y,z,confidence,expected_error"
    assert float(line.split(",")[-1]) == pytest.approx(error.values[20, 25, 30], abs=1e-4)
    row = rows(here / "run")["pair_0"]
    assert row["seconds"].keys() >= {"write", "program", "read"}
    assert row["program_cpu"] > 0 and row["mean_error"] > 0 and "border" not in row
    assert not list((here / "scratch").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAILURES)
def test_each_failure_is_a_row_and_the_other_scene_is_written(here: Path, pairs: Path, kind: str):
    assert register(pairs, "run", "-q", "--set", f"parameters.kind={kind}") == 3
    assert_one_failed(here, "pair_1", ["done", "failed"], FAILURES[kind], "fixed.nii.gz")


@pytest.mark.slow
def test_workers_write_the_same_bytes_and_runs_go_on(here: Path, pairs: Path, capsys):
    assert register(pairs, "one", "-q") == 0
    assert register(pairs, "two", "-q", "--jobs", "2") == 0
    files = [path.relative_to(here / "one") for path in (here / "one").glob("pair_*/*")]
    assert len(files) == 9
    for file in files:
        assert (here / "two" / file).read_bytes() == (here / "one" / file).read_bytes(), file
    assert register(pairs, "one") == 0
    assert "2 of 2 scenes are done already" in capsys.readouterr().err
    (here / "difference.py").write_text(PROGRAM.replace("/ 100", "/ 50"))
    before = read_volume(here / "one" / "pair_0" / "expected_error.nii.gz").values
    assert register(pairs, "one", "-q") == 0
    np.testing.assert_allclose(read_volume(here / "one" / "pair_0" / "expected_error.nii.gz").values, 2 * before)


@pytest.mark.slow
def test_volumes_of_other_formats_and_places_are_written_for_it(here: Path):
    axes = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    grid = Grid((9, 8, 6), (1.0, 2.0, 3.0), (-4.0, 5.0, 6.0), axes)
    rng = np.random.default_rng(0)
    for name in ("fixed", "moving_warped"):
        write_array(here / "turned" / f"{name}.mha", grid, rng.random(grid.shape, np.float32))
    for kind in ("mha", "nrrd", "nii"):
        assert register(here / "turned", kind, "-q", "--set", f"format={kind}") == 0
        assert read_volume(here / kind / "turned" / "expected_error.mha").grid.same_as(grid)


@pytest.mark.slow
def test_it_is_a_method_for_python(here: Path):
    fixed = np.random.default_rng(0).random((6, 8, 9), np.float32)
    found = depthcli.registration_confidence(fixed, fixed + 1, (3, 2, 1), "c.yaml")
    np.testing.assert_allclose(found.values, 0.01, rtol=1e-4)
    assert list(found.at([[1, 2, 3]])[0]) == ["x", "y", "z", "confidence", "expected_error"]
    with pytest.raises(depthcli.InputError, match="shift: this pipeline searches for no matches"):
        _ = found.shift
    found.save(here / "saved")
    assert not list((here / "saved").glob("shift*"))


def test_the_search_is_meant_where_a_config_names_no_pipeline(here: Path, pairs: Path, capsys):
    assert RegisterConfidenceConfig().pipeline == RegistrationSearch()
    config = RegisterConfidenceConfig.model_validate({"radius": 3, "neurological": True})
    assert config.pipeline == RegistrationSearch(radius=3) and config.neurological
    assert config.model_dump()["pipeline"] == "search"
    (here / "old.yaml").write_text("features: [mind]\nradiuss: 3\n")
    assert main(["register-confidence", "old.yaml", "-i", str(pairs), "-o", "x"]) == 2
    assert "old.yaml:2: radiuss: no such key (got 3); did you mean 'radius'?" in capsys.readouterr().err
    words = json.dumps([sys.executable, "difference.py", "{moving}"])
    assert main(["register-confidence", "c.yaml", "-i", "x", "-o", "y", "--set", f"program={words}"]) == 2
    assert "no placeholder {moving}; there are: fixed, warped, output" in capsys.readouterr().err
