"""``depthcli transparent`` on generated frames: files, evaluation, what cannot be used."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.io.formats.disparity import read_pfm, write_pfm
from depthcli.io.formats.images import read_image
from tests.command_line import rows, run, vertices
from tests.files import laid


def test_a_mask_of_the_objects_alone(made_glass, tmp_path, tool):
    frame, made = Path(shutil.copytree(made_glass / "glass_0", tmp_path / "frames" / "a")), tmp_path / "run" / "a"
    command = ("transparent", "sensor", "-i", frame.parent, "-o", made.parent, "--overwrite", "-q")
    (frame / "sparse.pfm").unlink()
    tool.told(3, "transparent", "sparse", *command[2:-2])
    (frame / "ir.png").unlink()
    tool.told(3, "transparent", "kinect", *command[2:])
    assert run(*command, "--ply", "--intrinsics", "100,100,64,48") == 0
    row = rows(made.parent)["a"]
    assert "not of the objects" in str(row["warnings"]) and row["intrinsics"] == "of the camera"
    objects = read_image(frame / "mask_transparent.png") == 255
    sensor, depth, bound = (read_pfm(file) for file in (frame / "depth.pfm", made / "depth.pfm", made / "bound.pfm"))
    kept = np.isfinite(sensor) & ~objects
    np.testing.assert_array_equal(depth[kept], sensor[kept])
    assert np.isfinite(depth).all() and (made.parent / "status.txt").is_file()
    assert 0.1 < np.median(bound[kept] * 24 / depth[kept] ** 2) < 0.5  # pixels; the noise is 0.1
    assert np.median(bound[objects]) > 5 * np.median(bound[kept])
    around = kept & (cv2.dilate(objects.astype(np.uint8), np.ones((61, 61), np.uint8)) > 0)
    assert sensor[around].min() * 0.9 < depth[objects].min() and depth[objects].max() < sensor[around].max() * 1.1
    assert row["replaced"] == pytest.approx(np.mean(objects & np.isfinite(sensor)), abs=1e-6)
    cloud = vertices(made / "points.ply")["xyz"]
    assert len(cloud) == kept.sum()
    np.testing.assert_allclose(cloud[0], depth[0, 0] * np.array([-0.64, -0.48, 1]), rtol=1e-4)
    near = float(np.median(depth))
    assert run(*command, "--ply", "--near", near, "--mask", "all") == 0
    assert len(vertices(made / "points.ply")) == (depth >= near).sum()
    # By options, as in a folder; refused where a config does not look at it.
    names = {"--color": "color.png", "--depth": "depth.pfm", "--objects": "mask_transparent.png"}
    files = ["--name", "a", *(word for option, name in names.items() for word in (option, frame / name))]
    assert run(*command[:2], *files, "-o", tmp_path / "single", "-q") == 0
    np.testing.assert_allclose(read_pfm(tmp_path / "single" / "a" / "depth.pfm"), depth, rtol=1e-6)
    tool.told(2, "transparent", "sparse", *files, "-o", tmp_path / "none", "-q")
    assert run(*command[:4], *files[-2:], "-o", tmp_path / "none", "-q") == 2
    # What lies inside the mask does not count.
    write_pfm(frame / "depth.pfm", np.where(objects, np.float32(0.1), sensor))
    assert run(*command) == 0
    np.testing.assert_array_equal(read_pfm(made / "depth.pfm"), depth)
    (frame / "mask_transparent.png").unlink()
    tool.told(3, *command)


def test_scores_say_that_sparse_depth_is_from_the_truth_and_memory_is_respected(made_glass, tmp_path, tool):
    frames = Path(shutil.copytree(made_glass, tmp_path / "in"))
    words = ("-i", frames, "-o", tmp_path / "run", "--evaluate", "--json")
    assert "from the truth" in json.dumps(json.loads(tool.out(0, "transparent", "nearest", *words))["evaluation"])
    kinect = ("transparent", "kinect", *words)
    assert "from the truth" not in tool.out(0, *kinect, "--overwrite")  # its sparse depth is of stereo
    meta = frames / "glass_0" / "meta.json"
    meta.write_text(json.dumps(json.loads(meta.read_text()) | {"max_disparity": 9}))
    planned = {row["scene"]: row["status"] for row in json.loads(tool.out(0, *kinect, "--dry-run"))["scenes"]}
    assert planned == {"glass_0": "to do", "glass_1": "done, kept"}  # another range of stereo is another result
    words = ("-i", made_glass, "-o", tmp_path / "crf", "--json", "--max-memory", "20MiB")
    assert "needs about" in json.loads(tool.out(3, "transparent", "crf", *words))["scenes"][0]["error"]


def test_each_scene_that_cannot_be_used_is_one_line_and_the_others_are_written(made_glass, tmp_path):
    """Scenes beside a good one, each with one thing that cannot be used, and what is said of it by which preset."""
    camera = {"K": [[100, 0, 64], [0, 100, 48], [0, 0, 1]], "size": [128, 96]}
    rig = {"color": camera, "infrared": camera, "R": np.eye(3).tolist(), "t": [-0.08, 0, 0]}

    def scene(name):
        return Path(shutil.copytree(made_glass / "glass_0", tmp_path / "in" / name))

    (scene("no_calibration") / "calib.json").unlink()
    laid(scene("apart"), {"calib.json": rig | {"R": [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]}})
    for name, file in (("small_infrared", "ir.png"), ("small_color", "color.png")):
        laid(scene(name), {file: read_image(made_glass / "glass_0" / file)[:50, :60]})
    for name, file in (("blind", "depth.pfm"), ("no_samples", "sparse.pfm")):
        laid(scene(name), {file: np.full((96, 128), np.nan, np.float32)})
    scene("z_good")
    size, blind = "60 x 50", "no pixel has a depth"
    for preset, said in {
        "kinect": {
            "apart": "nothing in common", "blind": blind, "no_calibration": "no calibration",
            "small_color": size, "small_infrared": size,
        },
        "nearest": {"blind": blind, "no_samples": f"sparse.pfm: {blind}", "small_color": size},
    }.items():  # fmt: skip
        made, stereo = tmp_path / preset, preset == "kinect"
        assert run("transparent", preset, "-i", tmp_path / "in", "-o", made) == 3
        found = rows(made)
        failed = {name: row["error"] for name, row in found.items() if row["status"] == "failed"}
        assert set(failed) == set(said)
        assert all(said[name] in error and "\n" not in error for name, error in failed.items())
        assert {path.parent.name for path in made.glob("*/depth.pfm")} == set(found) - set(said)
        wanted = {"unreliable.png", "depth.pfm", *(("stereo.png", "confidence_stereo.pfm") if stereo else ())}
        assert {path.name for path in (made / "z_good").iterdir()} >= wanted
        assert ({"rectify", "stereo", "crf"} <= set(found["z_good"]["seconds"])) == stereo
