"""register-confidence from the command line: files, messages, exit codes."""

import json
import re
import shutil
import warnings
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from depthcli.core.errors import ConfigError
from depthcli.core.volumes import Grid, RegisteredPair
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.io.scenes import VolumePairScene
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes, named_scenes
from depthcli.io.volume_pairs import LoadedPair
from depthcli.methods.registration.pipeline import RegistrationResult
from depthcli.problems.registration import inside_figures
from tests import command_line
from tests.command_line import rows
from tests.files import laid
from tests.golden import refused, told
from tests.io.test_volumes import slices

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    SimpleITK = pytest.importorskip("SimpleITK")

SMALL = ("--set", "radius=3", "--set", "half_window=1", "-q")
VOLUMES = ("confidence", "expected_error", "bound", "probability", "shift")
FILES = {"preview.png", "record.json", "status.nii.gz", *(f"{name}.nii.gz" for name in VOLUMES)}


def write_volumes(folder, grid, **volumes):
    for name, values in volumes.items():
        write_array(folder / f"{name}.mha", grid, values)
    return folder


def register(method, *words):
    return command_line.run("register-confidence", method, *words, *SMALL)


@pytest.mark.slow
def test_evaluated_against_the_dense_truth(made_volumes, tmp_path, tool):
    run = tmp_path / "mind"
    assert register("mind", "-i", made_volumes, "-o", run) == 0
    words = ("--truth", made_volumes, "-o", tmp_path, "--json", "--html")
    found = json.loads(tool.out(0, "evaluate", run, *words))
    assert {path.name for path in (run / "pair_0").iterdir()} == FILES
    scores = {s["metric"]: s["value"] for s in found["results"][0]["scores"]}
    assert scores["Spearman"] > 0.6 and scores["MAE"] < 1.5 and 2 < scores["TRE"] < 3
    (coverage,) = (s["value"] for s in found["bounds"] if s["metric"] == "bound coverage")
    assert 75 < coverage <= 100
    # Reports say that they are estimates, and link files that are there.
    markdown = (tmp_path / "report.md").read_text()
    links = re.findall(r"!\[[^]]*\]\(([^)]+)\)", markdown)
    assert links and all((tmp_path / unquote(link)).is_file() for link in links)
    for text in (markdown, (tmp_path / "report.html").read_text()):
        assert "no guarantee" in text and "no medical device" in text


def write_points(file, points):
    np.savetxt(file, points, delimiter=",", header="x,y,z", comments="")


@pytest.fixture
def moved(made_volumes, tmp_path):
    """A single pair given by its moving volume and a field, with landmarks."""
    folder, fixed = tmp_path / "pair", read_volume(made_volumes / "pair_0" / "fixed.nii.gz")
    shift = np.full((*fixed.values.shape, 3), (3, 0, 0), np.float32)
    moving = np.roll(fixed.values, 2, axis=2)
    write_volumes(folder, fixed.grid, fixed=fixed.values, moving=moving, displacement=shift)
    points = fixed.grid.to_point(np.array([[20.0, 25.0, 25.0], [15.0, 30.0, 20.0]]))
    write_points(folder / "landmarks_fixed.csv", points)
    write_points(folder / "landmarks_moving.csv", points + np.array([3.0, 0.5, 0.0]))
    return folder


@pytest.mark.slow
def test_a_moving_volume_with_its_field_and_landmarks(moved, tmp_path):
    made, out = tmp_path / "run", tmp_path / "evaluated"
    assert register("mind", "-i", moved, "-o", made) == 0
    values = np.genfromtxt(made / "pair" / "points.csv", delimiter=",", names=True)
    names = "x,y,z,confidence,expected_error,shift_x,shift_y,shift_z,bound,probability"
    assert ",".join(values.dtype.names) == names
    assert (values["confidence"] > 0.5).all() and (values["probability"] > 0.8).all()
    assert (values["expected_error"] < values["bound"]).all() and (values["bound"] < 4.5).all()  # mm, of the search
    assert command_line.run("evaluate", made, "--truth", moved, "-o", out, "-q") == 0
    scored = np.genfromtxt(out / "points" / "run" / "pair.csv", delimiter=",", names=True)
    assert scored.dtype.names == ("x", "y", "z", "expected_error", "true_error")
    assert scored["true_error"] == pytest.approx([0.5, 0.5], abs=1e-3)
    assert scored["expected_error"] == pytest.approx(values["expected_error"], abs=0.05)
    files = {name: moved / f"{name}.mha" for name in ("fixed", "moving", "displacement")}
    one = [word for name, file in files.items() for word in (f"--{name}", file)]
    assert register("mind", *one, "--name", "pair", "-o", tmp_path / "one") == 0
    error = "pair/expected_error.mha"
    assert (tmp_path / "one" / error).read_bytes() == (made / error).read_bytes()


@pytest.mark.slow
def test_open_bounds_are_counted_apart(moved, tmp_path, tool):
    grid = read_volume(moved / "fixed.mha").grid
    write_array(moved / "displacement.mha", grid, np.full((*grid.shape, 3), (-9, 0, 0), np.float32))
    assert register("mind", "-i", moved, "--field", "itk", "--within", "20", "-o", tmp_path / "run") == 0
    lines = (tmp_path / "run" / "pair" / "points.csv").read_text().splitlines()[1:]
    assert all(line.split(",")[-2].startswith("> 4.9") for line in lines)
    found = json.loads(tool.out(0, "evaluate", tmp_path / "run", "--truth", moved, "-o", tmp_path / "e", "--json"))
    values = {s["metric"]: s["value"] for s in found["bounds"]}
    assert values["bound coverage"] is None and values["bound finite"] == 0 and values["bound median"] is None


def test_a_field_and_a_transform_are_refused_unless_one_counts(tmp_path):
    names = ("fixed.mha", "moving.mha", "displacement.mha", "transform.tfm")
    folder = laid(tmp_path / "pair", dict.fromkeys(names, ""))
    (scene,) = discover_scenes(folder, ALL_KINDS)
    assert "both displacement.mha and transform.tfm; take away the one" in scene.problem
    files = {"displacement": folder / "displacement.mha", "transform": folder / "transform.tfm"}
    given = files | {"fixed": folder / "fixed.mha", "moving": folder / "moving.mha"}
    for wrong in ({}, {"apply": "field"}):
        refused(ConfigError, named_scenes, VolumePairScene, given | wrong)
    for apply, counting in {"displacement": {"displacement"}, "transform": {"transform"}, "both": set(files)}.items():
        laid(folder, {"meta.json": {"apply": apply}})
        for pair in (*discover_scenes(folder, ALL_KINDS), *named_scenes(VolumePairScene, given | {"apply": apply})):
            assert not pair.problem
            assert {role for role in files if getattr(pair, role) is not None} == counting


@pytest.mark.slow
def test_bad_input_is_one_line_and_spoils_no_other(made_volumes, tmp_path, tool):
    shutil.copytree(made_volumes / "pair_0", tmp_path / "pairs" / "pair_0")
    grid, empty, field, truncated = (
        Path(shutil.copytree(made_volumes / "pair_1", tmp_path / "pairs" / name))
        for name in ("grid", "empty mask", "field", "truncated")
    )
    fixed = read_volume(grid / "fixed.nii.gz")
    write_array(grid / "moving_warped.nii.gz", Grid(fixed.grid.size, (2.0, 1.5, 2.0)), fixed.values)
    write_array(empty / "mask.nii.gz", fixed.grid, 0 * fixed.values)
    (field / "moving_warped.nii.gz").rename(field / "moving.nii.gz")
    np.savez(field / "displacement.npz", np.zeros((56, 56, 39, 3), np.float32))
    data = (truncated / "moving_warped.nii.gz").read_bytes()
    (truncated / "moving_warped.nii.gz").write_bytes(data[: len(data) // 2])
    command = ("register-confidence", "axes", "-i", tmp_path / "pairs", "-o", tmp_path / "run", *SMALL)
    assert tool.told(3, *command).count("\n") == 4
    assert (tmp_path / "run" / "pair_0" / "confidence.nii.gz").is_file()
    laid(tmp_path, {"pairs.csv": "fixed,moving\na.mha,b.mha\n"})  # a table, which is not taken
    tool.told(2, "register-confidence", "axes", "-i", tmp_path / "pairs.csv", "-o", tmp_path / "run")


@pytest.mark.parametrize("special", [np.inf, 3e38, 1e20, 1e-40])
def test_special_values_cause_no_warning(tmp_path, special):
    """Values outside of the mask that are no numbers, and finite ones whose squares are none."""
    rng, grid, pair = np.random.default_rng(0), Grid((16, 14, 12), (1.0, 1.0, 1.0)), tmp_path / "pair"
    inside = np.ones(grid.shape, np.uint8)
    for name in ("fixed", "moving_warped"):
        values = rng.standard_normal(grid.shape).astype(np.float32)
        if special < 1:
            values *= np.float32(special)
        else:
            values[1, 1, :2] = special, -special if np.isinf(special) else special  # a value below -500 means CT
            values[2, 2, 2] = np.nan
        inside[~np.isfinite(values)] = 0
        write_array(pair / f"{name}.mha", grid, values)
    write_array(pair / "mask.mha", grid, inside)
    assert register("axes", "-i", pair, "-o", tmp_path / "run") == 0
    for name in ("confidence", "expected_error", "shift"):
        assert np.isfinite(read_volume(tmp_path / "run" / "pair" / f"{name}.mha", vector=name == "shift").values).all()


def test_reports_say_how_large_errors_are_in_the_body_and_where(tmp_path, tool):
    rng = np.random.default_rng(0)
    grid = Grid((40, 36, 32), (1.5, 1.5, 2.0), (-20.0, 10.0, 5.0))
    fixed = np.zeros(grid.shape, np.float32)
    fixed[2:30, 4:32, 4:36] = rng.uniform(0.5, 1, (28, 28, 32))
    warped = fixed.copy()
    warped[8:24, 8:28, 20:34] = np.roll(fixed, 3, axis=2)[8:24, 8:28, 20:34]  # 4.5 mm
    pair = write_volumes(tmp_path / "pair", grid, ct_plan=fixed, ct_warped=warped)
    command = ("register-confidence", "intensity", "-o", tmp_path / "run")
    tool.told(2, *command, "-i", pair)
    out, err = tool.both(0, *command, "--fixed", pair / "ct_plan.mha", "--warped", pair / "ct_warped.mha", "--html")
    told(err)
    assert "95 % mm" in out and "expected mm" not in out
    page = (tmp_path / "run" / "evaluation" / "report.html").read_text()
    assert "above 3 mm, mL" in page and "mean mm" not in page


def test_figures_in_the_body_are_of_blocks_of_voxels():
    error, ones = np.zeros((4, 4, 4), np.float32), np.ones((4, 4, 4), np.float32)
    error[2, 2, 1] = 5
    pair = RegisteredPair(ones, ones, (2.0, 2.0, 2.0), ones > 0)
    loaded = LoadedPair(pair, Grid((8, 8, 8), (1.0, 1.0, 1.0)), (2, 2, 2))
    result = RegistrationResult(expected_error=error, step=(1, 1, 1), start=(0, 0, 0))
    found = inside_figures(result, loaded)
    assert found["above_3mm"] == 0.008
    assert [found[f"above_{axis}"] for axis in "xyz"] == [2.5, 4.5, 4.5]
    assert inside_figures(result, replace(loaded, pair=replace(pair, mask=ones > 1))) == {}


def test_figures_that_stop_at_the_border_of_the_search_are_lower_bounds(made_volumes, tmp_path, tool):
    run, given, scored = tmp_path / "run", made_volumes / "pair_0", tmp_path / "e"
    command = ("register-confidence", "axes", "--set", "radius=1", "-o", run)
    files = ("--fixed", given / "fixed.nii.gz", "--warped", given / "moving_warped.nii.gz", "--name", "one")
    out, err = tool.both(0, *command, *files, "--html")
    told(err)
    row = rows(run)["one"]
    (warning,) = row["warnings"]
    page = (run / "evaluation" / "report.html").read_text()
    assert f"> {row['inside_mean']:.2f}" in out and f"<td>&gt; {row['inside_max']:.1f}</td>" in page and warning in page
    one = ("-i", made_volumes, "--scenes", "pair_0")
    assert tool.err(0, *command, *one, "--overwrite", "--evaluate", "--html").count("border of the search") == 1
    tool.told(0, *command, *one)  # of a scene that was done
    tool.told(0, "evaluate", run, "--truth", *one[1:], "-o", scored)
    for file in (run / "evaluation" / "report.md", run / "evaluation" / "report.html", scored / "report.md"):
        assert "border of the search" in file.read_text()


@pytest.mark.parametrize(("landmarks", "moving", "words"), [
    ("x,y,z\n-30,35,10\n500,0,0\n", "", ("1 of 2", "point 2")),
    ("x,y,z\n30,-35,10\n", "", ("with x and y negated they fit",)),
    ("not,a\n", "", ("landmarks_fixed.csv",)),
    ("x,y,z\n-30,35,10\n", "x,y,z\n-30,35,10\n", ("landmarks_moving.csv", "displacement.*")),  # of a warped volume
])  # fmt: skip
def test_bad_landmarks_stop_no_map_and_say_what_is_wrong(tmp_path, tool, landmarks, moving, words):
    pair, made, grid = tmp_path / "pair", tmp_path / "run", Grid((16, 14, 12), (1.0, 1.0, 2.0), (-40.0, 30.0, 5.0))
    values = np.random.default_rng(0).standard_normal(grid.shape).astype(np.float32)
    write_volumes(pair, grid, fixed=values, moving_warped=np.roll(values, 1, axis=2))
    laid(pair, {"landmarks_fixed.csv": landmarks, **({"landmarks_moving.csv": moving} if moving else {})})
    assert register("axes", "-i", pair, "-o", made) == 0
    row = rows(made)["pair"]
    assert row["status"] == "done" and any(all(word in line for word in words) for line in row["warnings"])
    assert (made / "pair" / "expected_error.mha").is_file()
    assert (made / "pair" / "points.csv").exists() == bool(moving)
    if moving:
        tool.told(2, "evaluate", made, "--truth", pair, "-o", tmp_path / "e")


def test_a_folder_with_a_dicom_series_is_a_volume(tmp_path, tool):
    places = [f"-20\\10\\{5 + 2 * k}" for k in range(12)]  # names of files are in another order from 10 on
    before, after = slices(tmp_path / "a", places), slices(tmp_path / "b", places[::-1])
    volume = read_volume(before)
    np.testing.assert_array_equal(volume.values, np.arange(12)[:, None, None] * np.ones((5, 6)))
    assert (volume.grid.spacing, volume.grid.origin) == ((1.0, 1.0, 2.0), (-20, 10, 5))
    command = ("register-confidence", "axes", "--fixed", before, "-o", tmp_path / "run", *SMALL, "--warped")
    assert command_line.run(*command, after) == 0
    assert read_volume(tmp_path / "run" / "a" / "expected_error.mha").grid.same_as(volume.grid)
    shutil.copy(before / "1_1.dcm", after)
    assert '"to do"' in tool.out(0, *command, after, "--dry-run", "--json")  # a slice has changed
    err = tool.err(3, *command, slices(tmp_path / "gap", [*places[:4], *places[5:]]), "--overwrite")
    assert "gap" in err and "missing" in err
