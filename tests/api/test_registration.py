"""``registration_confidence`` from Python: bytes of saved files, SimpleITK images, inputs, errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import depthcli
from depthcli.cli import main
from depthcli.io.formats.volumes import read_volume
from tests.api.test_stereo import assert_same_files


@pytest.fixture(scope="module")
def volumes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("volumes")
    assert main(["sample", "--registration", "-n", "1", "-o", str(folder), "-q"]) == 0
    return folder


def test_saved_files_are_those_of_the_command(tmp_path: Path, volumes: Path):
    fixed, warped, mask = (read_volume(volumes / "pair_0" / f"{n}.nii.gz") for n in ("fixed", "moving_warped", "mask"))
    spacing = fixed.grid.spacing[::-1]
    found = depthcli.registration_confidence(
        fixed.values, warped.values, spacing, mask=mask.values, origin=fixed.grid.origin,
        direction=np.reshape(fixed.grid.direction, (3, 3)), max_voxels=30000,
    )  # fmt: skip
    found.save(tmp_path / "python")
    run = str(tmp_path / "run")
    assert main(["register-confidence", "mind", "-i", str(volumes), "--set", "max_voxels=30000", "-o", run, "-q"]) == 0
    assert_same_files(tmp_path / "python", tmp_path / "run" / "pair_0")
    written = {name: read_volume(tmp_path / "python" / f"{name}.nii.gz") for name in ("expected_error", "confidence")}
    assert np.array_equal(written["expected_error"].values, found.values)
    assert np.array_equal(written["confidence"].values, found.confidence)
    assert found.shift.shape == (*found.values.shape, 3)
    center = fixed.grid.to_point(np.array([[20.0, 28, 28]]))
    (row,) = found.at(center)
    assert row["expected_error"] == pytest.approx(found.values[20, 28, 28], abs=0.1)
    assert {"search", "other"} <= set(found.seconds)
    assert found._repr_png_().startswith(b"\x89PNG") and "mm expected" in repr(found)


def test_images_of_simple_itk_know_where_they_are(volumes: Path):
    sitk = pytest.importorskip("SimpleITK")
    images = [sitk.ReadImage(str(volumes / "pair_0" / f"{n}.nii.gz")) for n in ("fixed", "moving_warped")]
    arrays = [sitk.GetArrayFromImage(image) for image in images]
    found = depthcli.registration_confidence(*images, preset="axes")
    spacing = images[0].GetSpacing()[::-1]
    again = depthcli.registration_confidence(*arrays, spacing, preset="axes")
    assert np.array_equal(found.values, again.values)
    assert found.grid.spacing == images[0].GetSpacing() and found.grid.origin == images[0].GetOrigin()
    images[1].SetSpacing((1.0, 1.0, 9.0))
    with pytest.raises(depthcli.InputError, match=r"warped: another grid than the fixed volume's .spacing"):
        depthcli.registration_confidence(*images, preset="axes")


SHAPE = (6, 8, 9)
FIXED = np.random.default_rng(0).random(SHAPE, np.float32)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"spacing": None}, "fixed: an array needs its spacing"),
        ({"warped": FIXED[:5]}, "warped: another grid .*size 9 x 8 x 5, expected 9 x 8 x 6"),
        ({"warped": np.where(FIXED > 0.9, np.nan, FIXED)}, r"warped: \d+ voxels are no numbers"),
        ({"fixed": np.zeros(SHAPE)}, "fixed: all voxels are 0"),
        ({"mask": np.zeros(SHAPE)}, "mask: no voxel is set"),
    ],
)
def test_wrong_volumes_are_refused(arguments: dict[str, Any], message: str):
    with pytest.raises(depthcli.InputError, match=message):
        depthcli.registration_confidence(**{"fixed": FIXED, "warped": FIXED, "spacing": (1, 1, 1), **arguments})
