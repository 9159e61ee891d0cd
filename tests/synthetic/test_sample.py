"""Writing generated scenes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from depthcli.core.errors import InputError, OutputError
from depthcli.io.images import read_image
from depthcli.io.scenes import find_scenes
from depthcli.jobs.sample import SampleOptions, write_cross_modal, write_samples
from depthcli.synthetic.stereo_scenes import make_scene

SMALL = SampleOptions(count=5, width=64, height=48, max_disparity=10)


def _bytes(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_scenes_read_back_as_they_were_made(tmp_path):
    rows = write_samples(tmp_path, SMALL)
    assert [row.scene for row in rows] == ["planes_0", "foreground_0", "repetitive_0", "curved_0", "planes_1"]
    scenes = {scene.name: scene for scene in find_scenes(tmp_path)}
    assert set(scenes) == {row.scene for row in rows}
    made = make_scene("planes", 1, 64, 48, 10)
    stored = scenes["planes_1"]
    left, right = stored.load_pair()
    np.testing.assert_array_equal(left, made.left)
    np.testing.assert_array_equal(right, made.right)
    truth = stored.load_truth()
    np.testing.assert_array_equal(truth.disparity, made.disparity_left)
    np.testing.assert_array_equal(truth.right, made.disparity_right)
    np.testing.assert_array_equal(truth.masks["nonocc"], made.nonocc)
    np.testing.assert_array_equal(truth.masks["disc"], made.disc)
    assert truth.masks["all"].all()
    assert stored.max_disparity == 10
    assert truth.metric == "v2"
    meta = json.loads((tmp_path / "planes_1" / "meta.json").read_text())
    assert set(meta) == {
        "files", "disp_scale", "max_disparity", "width", "height", "unknown_value", "masks", "source", "notes",
    }  # fmt: skip
    assert sorted(p.name for p in (tmp_path / "planes_1").iterdir()) == sorted([*meta["files"], "meta.json"])


def test_same_options_same_bytes_and_a_second_run_keeps_them(tmp_path):
    options = SMALL.model_copy(update={"noise": 3.0, "radiometric": 0.5, "cross_modal": True, "speckles": 0.02})
    write_samples(tmp_path / "a", options)
    write_samples(tmp_path / "b", options)
    first = _bytes(tmp_path / "a")
    assert first == _bytes(tmp_path / "b")
    stamps = {p: p.stat().st_mtime_ns for p in (tmp_path / "a").rglob("*.png")}
    assert {row.status for row in write_samples(tmp_path / "a", options)} == {"kept"}
    assert stamps == {p: p.stat().st_mtime_ns for p in (tmp_path / "a").rglob("*.png")}
    assert read_image(tmp_path / "a" / "planes_0" / "left.png").ndim == 2


def test_a_stopped_run_is_finished_with_the_same_bytes(tmp_path):
    write_samples(tmp_path / "whole", SMALL)
    write_samples(tmp_path / "cut", SMALL.model_copy(update={"count": 2}))
    litter = tmp_path / "cut" / ".repetitive_0.partial~"
    litter.mkdir()
    (litter / "left.png").write_bytes(b"half")
    (tmp_path / "cut" / "planes_0" / "disp_left.pfm").unlink()
    rows = write_samples(tmp_path / "cut", SMALL)
    assert [row.status for row in rows] == ["written", "kept", "written", "written", "written"]
    assert _bytes(tmp_path / "whole") == _bytes(tmp_path / "cut")


def test_other_options_need_overwrite(tmp_path):
    write_samples(tmp_path, SMALL)
    before = _bytes(tmp_path)
    other = SMALL.model_copy(update={"noise": 5.0, "count": 7})
    with pytest.raises(OutputError, match="--overwrite"):
        write_samples(tmp_path, other)
    assert _bytes(tmp_path) == before
    assert {row.status for row in write_samples(tmp_path, other, overwrite=True)} == {"written"}
    assert _bytes(tmp_path)["planes_0/left.png"] != before["planes_0/left.png"]


def test_folders_of_others_are_never_touched(tmp_path):
    mine = tmp_path / "planes_0"
    mine.mkdir()
    (mine / "left.png").write_bytes(b"holiday")
    with pytest.raises(OutputError, match="did not make"):
        write_samples(tmp_path, SMALL, overwrite=True)
    assert _bytes(tmp_path) == {"planes_0/left.png": b"holiday"}


@pytest.mark.parametrize(
    "fields",
    [{"max_disparity": 40}, {"kinds": ("forest",)}, {"kinds": ()}, {"count": 0}, {"speckles": 0.1}, {"nois": 1}],
    ids=str,
)
def test_impossible_options_are_refused(fields):
    with pytest.raises(ValidationError):
        SampleOptions(**{"width": 64, "height": 48, "max_disparity": 10, **fields})


def test_every_option_is_described():
    assert all(field.description for field in SampleOptions.model_fields.values())


def test_cross_modal_keeps_the_truth(tmp_path):
    write_samples(tmp_path / "in", SMALL)
    (tmp_path / "in" / "curved_0" / "right.png").write_bytes(b"not a picture")
    rows = {row.scene: row for row in write_cross_modal(tmp_path / "in", tmp_path / "out", seed=2, speckles=0.01)}
    assert rows["curved_0"].status == "failed"
    assert "right.png" in rows["curved_0"].reason
    assert [row.status for name, row in rows.items() if name != "curved_0"] == ["written"] * 4
    before, after = ({s.name: s for s in find_scenes(tmp_path / f)}["planes_0"] for f in ("in", "out"))
    np.testing.assert_array_equal(before.load_truth().disparity, after.load_truth().disparity)
    np.testing.assert_array_equal(before.load_truth().masks["nonocc"], after.load_truth().masks["nonocc"])
    assert after.max_disparity == 10
    assert after.load_pair()[1].ndim == 2
    with pytest.raises(OutputError, match="other options"):
        write_cross_modal(tmp_path / "in", tmp_path / "in")
    with pytest.raises(InputError):
        write_cross_modal(tmp_path / "missing", tmp_path / "out")
