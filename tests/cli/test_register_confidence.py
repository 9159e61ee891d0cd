"""register-confidence from the command line: files, messages, exit codes."""

import json
import locale
import re
import shutil
import warnings
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.errors import ConfigError
from depthcli.core.volumes import Grid, RegisteredPair
from depthcli.io.formats.images import read_image
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.io.scenes import VolumePairScene
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes, named_scenes
from depthcli.io.volume_pairs import LoadedPair
from depthcli.methods.registration.pipeline import RegistrationResult
from depthcli.problems.registration import inside_figures
from tests.golden import refused, told

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    SimpleITK = pytest.importorskip("SimpleITK")

SMALL = ("--set", "radius=3", "--set", "half_window=1", "-q")
VOLUMES = ("confidence", "expected_error", "bound", "probability", "shift")
FILES = {"preview.png", "record.json", "status.nii.gz", *(f"{name}.nii.gz" for name in VOLUMES)}


@pytest.fixture(scope="module")
def run(made_volumes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "mind"
    assert main(["register-confidence", "mind", "-i", str(made_volumes), "-o", str(folder), *SMALL]) == 0
    return folder


@pytest.mark.slow
def test_evaluated_against_the_dense_truth(made_volumes, run, tmp_path, tool):
    found = json.loads(tool.out(0, "evaluate", run, "--truth", made_volumes, "-o", tmp_path / "e", "--json"))
    assert {path.name for path in (run / "pair_0").iterdir()} == FILES
    scores = {s["metric"]: s["value"] for s in found["results"][0]["scores"]}
    assert scores["Spearman"] > 0.6 and scores["MAE"] < 1.5 and 2 < scores["TRE"] < 3
    (coverage,) = (s["value"] for s in found["bounds"] if s["metric"] == "bound coverage")
    assert 75 < coverage <= 100


def moved_files(made_volumes, folder):
    """A single pair given by its moving volume and a field, with landmarks."""
    folder.mkdir()
    fixed = read_volume(made_volumes / "pair_0" / "fixed.nii.gz")
    shift = np.zeros((*fixed.values.shape, 3), np.float32)
    shift[..., 0] = 3.0
    write_array(folder / "fixed.mha", fixed.grid, fixed.values)
    write_array(folder / "moving.mha", fixed.grid, np.roll(fixed.values, 2, axis=2))
    write_array(folder / "displacement.mha", fixed.grid, shift)
    points = fixed.grid.to_point(np.array([[20.0, 25.0, 25.0], [15.0, 30.0, 20.0]]))
    np.savetxt(folder / "landmarks_fixed.csv", points, delimiter=",", header="x,y,z", comments="")
    matches = points + np.array([3.0, 0.5, 0.0])
    np.savetxt(folder / "landmarks_moving.csv", matches, delimiter=",", header="x,y,z", comments="")
    return folder


@pytest.mark.slow
def test_a_moving_volume_with_its_field_and_landmarks(made_volumes, tmp_path):
    folder = moved_files(made_volumes, tmp_path / "pair")
    assert main(["register-confidence", "mind", "-i", str(folder), "-o", str(tmp_path / "run"), *SMALL]) == 0
    rows = (tmp_path / "run" / "pair" / "points.csv").read_text().splitlines()
    assert rows[0] == "x,y,z,confidence,expected_error,shift_x,shift_y,shift_z,bound,probability"
    values = [dict(zip(rows[0].split(","), map(float, row.split(",")), strict=True)) for row in rows[1:]]
    assert all(v["confidence"] > 0.5 and v["probability"] > 0.8 for v in values)
    expected, bounds = ([v[name] for v in values] for name in ("expected_error", "bound"))
    assert all(e < b < 4.5 for e, b in zip(expected, bounds, strict=True))  # mm, the search ends at 4.5
    evaluated = tmp_path / "evaluated"
    assert main(["evaluate", str(tmp_path / "run"), "--truth", str(folder), "-o", str(evaluated), "-q"]) == 0
    rows = (evaluated / "points" / "run" / "pair.csv").read_text().splitlines()
    assert rows[0] == "x,y,z,expected_error,true_error"
    values = [dict(zip(rows[0].split(","), map(float, row.split(",")), strict=True)) for row in rows[1:]]
    assert [v["true_error"] for v in values] == pytest.approx([0.5, 0.5], abs=1e-3)
    assert [v["expected_error"] for v in values] == pytest.approx(expected, abs=0.05)
    one = ["--fixed", str(folder / "fixed.mha"), "--moving", str(folder / "moving.mha"),
           "--displacement", str(folder / "displacement.mha"), "--name", "pair"]  # fmt: skip
    assert main(["register-confidence", "mind", *one, "-o", str(tmp_path / "one"), *SMALL]) == 0
    name = "pair/expected_error.mha"
    assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "run" / name).read_bytes()


@pytest.mark.slow
def test_open_bounds_are_counted_apart(made_volumes, tmp_path, tool):
    folder = moved_files(made_volumes, tmp_path / "pair")
    grid = read_volume(folder / "fixed.mha").grid
    write_array(folder / "displacement.mha", grid, np.full((*grid.shape, 3), (-9, 0, 0), np.float32))
    words = ["-i", str(folder), "--field", "itk", "--within", "20", *SMALL]
    assert main(["register-confidence", "mind", *words, "-o", str(tmp_path / "run")]) == 0
    rows = (tmp_path / "run" / "pair" / "points.csv").read_text().splitlines()[1:]
    assert all(row.split(",")[-2].startswith("> 4.9") for row in rows)
    found = json.loads(tool.out(0, "evaluate", tmp_path / "run", "--truth", folder, "-o", tmp_path / "e", "--json"))
    values = {s["metric"]: s["value"] for s in found["bounds"]}
    assert values["bound coverage"] is None and values["bound finite"] == 0 and values["bound median"] is None


def test_a_field_and_a_transform_are_refused_unless_one_counts(tmp_path):
    folder = tmp_path / "pair"
    folder.mkdir()
    for name in ("fixed.mha", "moving.mha", "displacement.mha", "transform.tfm"):
        (folder / name).touch()
    (scene,) = discover_scenes(folder, ALL_KINDS)
    assert "both displacement.mha and transform.tfm; take away the one" in scene.problem
    files = {"displacement": folder / "displacement.mha", "transform": folder / "transform.tfm"}
    given = files | {"fixed": folder / "fixed.mha", "moving": folder / "moving.mha"}
    refused(ConfigError, named_scenes, VolumePairScene, given)
    for apply, counting in {"displacement": {"displacement"}, "transform": {"transform"}, "both": set(files)}.items():
        (folder / "meta.json").write_text(json.dumps({"apply": apply}))
        for pair in (*discover_scenes(folder, ALL_KINDS), *named_scenes(VolumePairScene, given | {"apply": apply})):
            assert not pair.problem
            assert {role for role in files if getattr(pair, role) is not None} == counting
    refused(ConfigError, named_scenes, VolumePairScene, given | {"apply": "field"})


def spoil(folder, what):
    fixed = read_volume(folder / "fixed.nii.gz")
    grid, values = fixed.grid, fixed.values
    if what == "grid":
        write_array(folder / "moving_warped.nii.gz", Grid(grid.size, (2.0, 1.5, 2.0)), values)
    elif what == "empty mask":
        write_array(folder / "mask.nii.gz", grid, 0 * values)
    elif what == "field":
        (folder / "moving_warped.nii.gz").rename(folder / "moving.nii.gz")
        np.savez(folder / "displacement.npz", np.zeros((56, 56, 39, 3), np.float32))
    else:
        data = (folder / "moving_warped.nii.gz").read_bytes()
        (folder / "moving_warped.nii.gz").write_bytes(data[: len(data) // 2])


@pytest.mark.slow
def test_bad_input_is_one_line_and_spoils_no_other(made_volumes, tmp_path, tool):
    shutil.copytree(made_volumes / "pair_0", tmp_path / "pairs" / "pair_0")
    for what in ("grid", "empty mask", "field", "truncated"):
        spoil(Path(shutil.copytree(made_volumes / "pair_1", tmp_path / "pairs" / what)), what)
    command = ["register-confidence", "axes", "-i", str(tmp_path / "pairs"), "-o", str(tmp_path / "run"), *SMALL]
    assert tool.told(3, *command).count("\n") == 4
    assert (tmp_path / "run" / "pair_0" / "confidence.nii.gz").is_file()


@pytest.mark.parametrize("special", [np.inf, 3e38, 1e20, 1e-40])
def test_special_values_cause_no_warning(tmp_path, special):
    """Values outside of the mask that are no numbers, and finite ones whose squares are none."""
    rng = np.random.default_rng(0)
    grid = Grid((16, 14, 12), (1.0, 1.0, 1.0))
    inside = np.ones(grid.shape, np.uint8)
    for name in ("fixed", "moving_warped"):
        values = rng.standard_normal(grid.shape).astype(np.float32)
        if special < 1:
            values *= np.float32(special)
        else:
            values[1, 1, :2] = special, -special if np.isinf(special) else special  # a value below -500 means CT
            values[2, 2, 2] = np.nan
        inside[~np.isfinite(values)] = 0
        write_array(tmp_path / "pair" / f"{name}.mha", grid, values)
    write_array(tmp_path / "pair" / "mask.mha", grid, inside)
    command = ["register-confidence", "axes", "-i", str(tmp_path / "pair"), "-o", str(tmp_path / "run"), *SMALL]
    assert main(command) == 0
    for name in ("confidence", "expected_error", "shift"):
        assert np.isfinite(read_volume(tmp_path / "run" / "pair" / f"{name}.mha", vector=name == "shift").values).all()


@pytest.mark.slow
def test_a_preview_is_mirrored_on_request(made_volumes, run, tmp_path):
    command = ["register-confidence", "mind", "-i", str(made_volumes), "--scenes", "pair_0", *SMALL, "--neurological"]
    assert main([*command, "-o", str(tmp_path)]) == 0
    first, mirrored = (read_image(folder / "pair_0" / "preview.png").astype(int) for folder in (run, tmp_path))
    assert first.shape == mirrored.shape and first.shape[1] >= 1200  # the bound is the fourth column
    assert abs(first - mirrored).mean() > 1


def test_reports_say_how_large_errors_are_in_the_body_and_where(tmp_path, tool):
    rng = np.random.default_rng(0)
    grid = Grid((40, 36, 32), (1.5, 1.5, 2.0), (-20.0, 10.0, 5.0))
    fixed = np.zeros(grid.shape, np.float32)
    fixed[2:30, 4:32, 4:36] = rng.uniform(0.5, 1, (28, 28, 32))
    warped = fixed.copy()
    warped[8:24, 8:28, 20:34] = np.roll(fixed, 3, axis=2)[8:24, 8:28, 20:34]  # 4.5 mm
    for name, values in (("ct_plan", fixed), ("ct_warped", warped)):
        write_array(tmp_path / "pair" / f"{name}.mha", grid, values)
    command = ["register-confidence", "intensity", "-o", str(tmp_path / "run")]
    tool.told(2, *command, "-i", tmp_path / "pair")
    files = ["--fixed", str(tmp_path / "pair" / "ct_plan.mha"), "--warped", str(tmp_path / "pair" / "ct_warped.mha")]
    shown = tool.both(0, *command, *files, "--html")
    told(shown.err)
    assert "95 % mm" in shown.out and "expected mm" not in shown.out
    page = (tmp_path / "run" / "evaluation" / "report.html").read_text()
    assert "above 3 mm, mL" in page and "mean mm" not in page


def test_figures_in_the_body_are_of_blocks_of_voxels():
    error, ones = np.zeros((4, 4, 4), np.float32), np.ones((4, 4, 4), np.float32)
    error[2, 2, 1] = 5
    pair = RegisteredPair(ones, ones, (2.0, 2.0, 2.0), ones > 0)
    loaded = LoadedPair(pair, Grid((8, 8, 8), (1.0, 1.0, 1.0)), (2, 2, 2))
    found = inside_figures(RegistrationResult(expected_error=error, step=(1, 1, 1), start=(0, 0, 0)), loaded)
    assert found["above_3mm"] == 0.008
    assert [found[f"above_{axis}"] for axis in "xyz"] == [2.5, 4.5, 4.5]
    nowhere = replace(loaded, pair=replace(pair, mask=ones > 1))
    assert inside_figures(RegistrationResult(expected_error=error, step=(1, 1, 1), start=(0, 0, 0)), nowhere) == {}


def test_figures_that_stop_at_the_border_of_the_search_are_lower_bounds(made_volumes, tmp_path, capsys, tool):
    run, given = tmp_path / "run", made_volumes / "pair_0"
    command = ["register-confidence", "axes", "--set", "radius=1", "-o", str(run)]
    files = ["--fixed", str(given / "fixed.nii.gz"), "--warped", str(given / "moving_warped.nii.gz"), "--name", "one"]
    shown = tool.both(0, *command, *files, "--html")
    (row,) = json.loads((run / "report.json").read_text())["scenes"]
    (warning,) = row["warnings"]
    told(shown.err)
    assert f"> {row['inside_mean']:.2f}" in shown.out
    page = (run / "evaluation" / "report.html").read_text()
    assert warning in page and f"<td>&gt; {row['inside_max']:.1f}</td>" in page
    assert main([*command, "-i", str(made_volumes), "--scenes", "pair_0", "--overwrite", "--evaluate", "--html"]) == 0
    assert capsys.readouterr().err.count("border of the search") == 1
    tool.told(0, *command, "-i", made_volumes, "--scenes", "pair_0")  # of a scene that was done
    tool.told(0, "evaluate", run, "--truth", made_volumes, "--scenes", "pair_0", "-o", tmp_path / "e")
    for file in (run / "evaluation" / "report.md", run / "evaluation" / "report.html", tmp_path / "e" / "report.md"):
        assert "border of the search" in file.read_text()


def small_pair(folder, names=("fixed", "moving_warped")):
    grid = Grid((16, 14, 12), (1.0, 1.0, 2.0), (-40.0, 30.0, 5.0))
    values = np.random.default_rng(0).standard_normal(grid.shape).astype(np.float32)
    for k, name in enumerate(names):
        write_array(folder / f"{name}.mha", grid, np.roll(values, k, axis=2))
    return grid


@pytest.mark.parametrize(
    ("landmarks", "words"),
    [
        ("x,y,z\n-30,35,10\n500,0,0\n", ("1 of 2", "point 2")),
        ("x,y,z\n30,-35,10\n", ("with x and y negated they fit",)),
        ("not,a\n", ("landmarks_fixed.csv",)),
    ],
)
def test_bad_landmarks_stop_no_map_and_say_what_is_wrong(tmp_path, landmarks, words):
    small_pair(tmp_path / "pair")
    (tmp_path / "pair" / "landmarks_fixed.csv").write_text(landmarks)
    command = ["register-confidence", "axes", "-i", str(tmp_path / "pair"), "-o", str(tmp_path / "run"), *SMALL]
    assert main(command) == 0
    (row,) = json.loads((tmp_path / "run" / "report.json").read_text())["scenes"]
    assert row["status"] == "done" and any(all(word in line for word in words) for line in row["warnings"])
    assert (tmp_path / "run" / "pair" / "expected_error.mha").is_file()
    assert not (tmp_path / "run" / "pair" / "points.csv").exists()


def test_a_table_of_pairs_says_what_is_wanted(tmp_path, tool):
    (tmp_path / "pairs.csv").write_text("fixed,moving\na.mha,b.mha\n")
    tool.told(2, "register-confidence", "axes", "-i", tmp_path / "pairs.csv", "-o", tmp_path / "run")


def test_landmarks_of_a_warped_volume_say_what_they_need(tmp_path, tool):
    small_pair(tmp_path / "pair")
    for name in ("landmarks_fixed", "landmarks_moving"):
        (tmp_path / "pair" / f"{name}.csv").write_text("x,y,z\n-30,35,10\n")
    run = str(tmp_path / "run")
    assert main(["register-confidence", "axes", "-i", str(tmp_path / "pair"), "-o", run, *SMALL]) == 0
    (row,) = json.loads((tmp_path / "run" / "report.json").read_text())["scenes"]
    assert any("landmarks_moving.csv" in line and "displacement.*" in line for line in row["warnings"])
    assert (tmp_path / "run" / "pair" / "points.csv").is_file()
    tool.told(2, "evaluate", run, "--truth", tmp_path / "pair", "-o", tmp_path / "e")


def test_reports_say_that_they_are_estimates_and_link_files_that_are_there(made_volumes, run, tmp_path):
    evaluated = tmp_path / "e"
    assert main(["evaluate", str(run), "--truth", str(made_volumes), "-o", str(evaluated), "-q", "--html"]) == 0
    markdown = (evaluated / "report.md").read_text()
    links = re.findall(r"!\[[^]]*\]\(([^)]+)\)", markdown)
    assert links and all((evaluated / unquote(link)).is_file() for link in links)
    for text in (markdown, (evaluated / "report.html").read_text()):
        assert "no guarantee" in text and "no medical device" in text


def dicom(folder, values, missing=()):
    """Write a series of (Z, Y, X) int16, whose files are sorted the other way by name."""
    folder.mkdir()
    before = locale.setlocale(locale.LC_ALL)  # writing DICOM, which the program does not, leaves the C locale
    writer = SimpleITK.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    for k, plane in enumerate(values):
        image = SimpleITK.GetImageFromArray(plane)
        image.SetSpacing((1.5, 1.0))
        tags = {"0008|0060": "CT", "0020|000d": "1.2.3", "0020|000e": "1.2.3.4", "0008|0018": f"1.2.3.4.{k + 1}",
                "0020|0032": f"-20\\10\\{5 + 2 * k}", "0020|0037": "1\\0\\0\\0\\1\\0", "0020|0013": str(k)}  # fmt: skip
        for tag, text in tags.items():
            image.SetMetaData(tag, text)
        if k not in missing:
            writer.SetFileName(str(folder / f"{len(values) - k:03}.dcm"))
            writer.Execute(image)
    locale.setlocale(locale.LC_ALL, before)


def test_a_folder_with_a_dicom_series_is_a_volume(tmp_path, capsys, tool):
    values = np.random.default_rng(0).integers(-100, 900, (12, 14, 16)).astype(np.int16)
    for name, shift in (("before", 0), ("after", 1)):
        dicom(tmp_path / name, np.roll(values, shift, axis=2))
    dicom(tmp_path / "gap", values, missing=(4,))
    volume = read_volume(tmp_path / "before")
    np.testing.assert_array_equal(volume.values, values)
    assert (volume.grid.spacing, volume.grid.origin) == ((1.5, 1.0, 2.0), (-20, 10, 5))
    command = ["register-confidence", "axes", "--fixed", str(tmp_path / "before"), "-o", str(tmp_path / "run"), *SMALL]
    assert main([*command, "--warped", str(tmp_path / "after")]) == 0
    assert read_volume(tmp_path / "run" / "before" / "expected_error.mha").grid.same_as(volume.grid)
    (tmp_path / "after" / "001.dcm").write_bytes((tmp_path / "before" / "001.dcm").read_bytes())
    assert main([*command, "--warped", str(tmp_path / "after"), "--dry-run", "--json"]) == 0
    assert '"to do"' in capsys.readouterr().out  # a slice has changed
    assert "gap" in (err := tool.err(3, *command, "--overwrite", "--warped", tmp_path / "gap")) and "missing" in err
