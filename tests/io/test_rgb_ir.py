"""Frames with an infrared image, and the calibration of both cameras."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.cameras.rig import Rig
from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.layouts.depth import FRAMES
from depthcli.io.rgbd_frames import load_infrared_frame
from depthcli.io.scenes import RgbIrScene
from depthcli.io.walk import discover_scenes

K = [[190.0, 0, 20], [0, 190, 15], [0, 0, 1]]
RIG = {
    "color": {"K": K, "distortion": [0.1, 0, 0, 0, 0], "size": [40, 30]},
    "infrared": {"K": K, "size": [36, 28]},
    "R": np.eye(3).tolist(),
    "t": [-0.05, 0, 0],
}


def write(folder, calibration=RIG, infrared=(28, 36), dtype=np.uint8):
    rng = np.random.default_rng(0)
    write_png(folder / "color.png", rng.integers(0, 256, (30, 40, 3)).astype(np.uint8))
    write_png(folder / "ir.png", rng.integers(0, 200, infrared).astype(dtype))
    write_pfm(folder / "depth.pfm", np.full((30, 40), 0.9, np.float32))
    if calibration is not None:
        (folder / "calib.json").write_text(json.dumps(calibration))


def loaded(folder):
    (scene,) = discover_scenes(folder, FRAMES)
    assert isinstance(scene, RgbIrScene) and scene.layout == "rgb-ir"
    return load_infrared_frame(scene)


def test_a_rig_and_a_rectified_pair(tmp_path):
    write(tmp_path)
    frame = loaded(tmp_path)
    assert isinstance(frame.rig, Rig) and frame.infrared.shape == (28, 36)
    assert frame.rig.left.distortion[0] == 0.1
    write(tmp_path, {"rectified": True, "fb": 12.5}, (30, 40))
    frame = loaded(tmp_path)
    assert (frame.rig, frame.fb) == (None, 12.5)


def test_yaml_of_opencv(tmp_path):
    write(tmp_path, None)
    storage = cv2.FileStorage(str(tmp_path / "calib.yml"), cv2.FILE_STORAGE_WRITE)
    lenses = {"D1": [[0.1, 0, 0, 0, 0]], "D2": np.zeros((1, 5))}
    values = {"M1": K, "M2": K, **lenses, "R": np.eye(3), "T": [[-0.05], [0], [0]]}
    for name, value in values.items():
        storage.write(name, np.asarray(value, np.float64))
    storage.release()
    rig = loaded(tmp_path).rig
    assert rig is not None
    np.testing.assert_allclose(rig.translation, [-0.05, 0, 0])
    assert rig.left.distortion == (0.1, 0, 0, 0, 0)


def test_the_image_without_the_projector_is_used(tmp_path):
    write(tmp_path)
    write_png(tmp_path / "ir_noprojector.png", np.full((28, 36), 77, np.uint8))
    assert (loaded(tmp_path).infrared == 77).all()


def test_sixteen_bits_use_their_own_range(tmp_path):
    write(tmp_path, dtype=np.uint16)
    infrared = loaded(tmp_path).infrared
    assert infrared.dtype == np.uint8
    assert infrared.max() == 255
    assert 100 < infrared.mean() < 150


@pytest.mark.parametrize(
    ("change", "infrared", "said"),
    [
        (None, (28, 36), "no calibration"),
        ({"color": None}, (28, 36), "color: want K"),
        ({"t": [80, 0, 0]}, (28, 36), "baseline of 80 m; the translation is in meters"),
        ({"infrared": {"K": K, "size": [640, 480]}}, (28, 36), r"calibrated for a infrared image of \[640, 480\]"),
        ({"infrared": {"K": K, "distortion": [1, 2, 3]}}, (28, 36), "coefficients"),
        ({"rectified": True, "fb": 10.0}, (28, 36), "36 x 28, but color.png is 40 x 30"),
    ],
)
def test_what_cannot_be_used_says_why_in_a_line(tmp_path, change, infrared, said):
    write(tmp_path, None if change is None else {**RIG, **change}, infrared)
    with pytest.raises(InputError, match=said) as caught:
        loaded(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_the_command_runs_and_failures_are_rows(tmp_path, capsys):
    made, run = tmp_path / "made", tmp_path / "run"
    assert main(["sample", "--transparent", "--width", "128", "--height", "96", "-o", str(made), "-q"]) == 0
    (made / "glass_1" / "calib.json").unlink()
    assert main(["transparent", "kinect", "-i", str(made), "-o", str(run), "--json"]) == 3
    rows = json.loads(capsys.readouterr().out)["scenes"]
    assert [row["status"] for row in rows] == ["done", "failed"]
    assert "no calibration" in rows[1]["error"]
    names = {path.name for path in (run / "glass_0").iterdir()}
    assert {"stereo.png", "confidence_stereo.pfm", "unreliable.png", "depth.pfm"} <= names
    assert {"rectify", "stereo", "crf"} <= set(rows[0]["seconds"])
