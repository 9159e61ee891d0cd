"""Small tables in all the forms that spreadsheets and programs give them: landmarks, pairs, keys of calibrations."""

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.io.formats.calibrations import read_geometry
from depthcli.io.formats.fields import read_landmarks
from depthcli.io.formats.plain_text import json_object
from depthcli.io.formats.poses import read_poses
from depthcli.io.scenes.pairs import scenes_of_table
from tests.golden import refused

GRID = Grid((9, 8, 7), (1.0, 1.5, 2.5), (10.0, 20.0, 30.0))
POINTS = [(-11.5, 24.5, 35.0), (1.0, 2.0, 3.0), (4.25, 5.0, 6.0)]


def table(row: str, head: str = "", scale: float = 1.0, decimal: str = ".") -> str:
    """A line for every point: ``k`` counts from 0, ``n`` from 1, capitals are negated."""
    lines = [head] if head else []
    for k, (x, y, z) in enumerate(np.divide(POINTS, scale).tolist()):
        cells = {"x": x, "y": y, "z": z, "X": -x, "Y": -y}
        lines.append(row.format(k=k, n=k + 1, **{key: str(cell).replace(".", decimal) for key, cell in cells.items()}))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("text", [
    table("{x},{y},{z}"), table("{x} {y} {z}"), table("{x},\t{y},\t{z}"),
    table("{x}\t{y}\t{z}", decimal=","), table("{x};{y};{z}", "x;y;z", decimal=","),
    table('"{x}", "{y}", "{z}"', '"x", "y","z"'), table("{z},{y},{x}", "z,y,x"), table("{x},{y},{z}", "# x,y,z"),
    table("{x} {y} {z} 0.5", "# landmarks of the patient"),
    table("{n},{x},{y},{z}"), table("{k} {x} {y} {z}"), table("P{n},{x},{y},{z}"), table("{x},{y},{z},P{n}"),
    table("{n},{x},{y},{z}", "id,X (mm),Y (mm),Z (mm)"), table("{x} {y} {z}", "X (mm) Y (mm) Z (mm)"),
    table("{k},{x},{y},{z}", ",0,1,2"), table("{k},{x},{y},{z}", ",x,y,z"), table("{x},{y},{z}", "posX,posY,posZ"),
    table("{x},{y},{z}", "L,P,S"), table("{z},{X},{y}", "S (mm),R (mm),P (mm)"), table("{n},{X},{Y},{z}", "I,R,A,S"),
    table("{X},{Y},{z}", "x_ras,y_ras,z_ras"), table("{x}\t{y}\t{z}", "x [m]\ty [m]\tz [m]", scale=1000),
    table("1,2,3,{x},{y},{z}", "x_voxel,y_voxel,z_voxel,x,y,z"),
    table("{n},{x},{y},{z},0,0", "# Markups fiducial file version = 4.10\n# CoordinateSystem = LPS\n"
          "# columns = id,x,y,z,ow,ox"),
    table("{n},{X},{Y},{z},0,0", "# CoordinateSystem = 0\n# columns = id,x,y,z,ow,ox"),
])  # fmt: skip
def test_landmarks_in_every_form(text: str, tmp_path: Path):
    file = tmp_path / "landmarks_fixed.csv"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        file.write_bytes(text.encode(encoding))
        np.testing.assert_allclose(read_landmarks(file, GRID), POINTS, rtol=1e-12)


def test_tables_whose_columns_are_not_known(tmp_path: Path):
    for text in (
        "a,b,c,d\n5.5,1,2,3\n", "fixed_x,fixed_y,fixed_z,moving_x,moving_y,moving_z\n1,2,3,4,5,6\n",
        "i,j,k\n1,2,3\n", "x_voxel,y_voxel,z_voxel\n1,2,3\n", "x,y\n1,2\n", "1,2,3\n1,2,abc\n", "x,y,z\n",
        "1,2,3\n1,2,nan\n", "1,2,1e999\n", "1,2," + 140_000 * "3",
    ):  # fmt: skip
        (tmp_path / "a.csv").write_text(text)
        refused(InputError, read_landmarks, tmp_path / "a.csv", GRID)


def test_landmarks_in_every_unit(tmp_path: Path):
    for text, raw in (("# Gefäß\n11,24.5,35", False), ("z,y,x\n35,24.5,11\n", False), ("index\n1\n1 3 2\n", False),
                      ("2 4 3\n", True)):  # fmt: skip
        (tmp_path / "a.txt").write_text(text, "latin-1")  # mm, voxels from 0 (elastix), and from 1 (DIR-Lab)
        assert read_landmarks(tmp_path / "a.txt", GRID, raw).tolist() == [[11, 24.5, 35]]


@pytest.mark.parametrize(("separator", "name"), [(",", "a.csv"), ("\t", "a.csv"), (";", "a.csv"), ("\t", "a.tsv")])
def test_pairs_between_any_separators(separator: str, name: str, tmp_path: Path):
    rows = [("left", "right", "max_disparity"), ("a 1.png", "b,1.png" if separator != "," else "b1.png", "12")]
    text = "\n".join(separator.join(row) for row in rows)
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        (tmp_path / name).write_bytes(text.encode(encoding))
        (pair,) = scenes_of_table(tmp_path / name)
        assert pair.right is not None
        assert (pair.left.name, pair.right.name, pair.max_disparity) == (rows[1][0], rows[1][1], 12)


def test_a_byte_order_mark_hides_no_key(tmp_path: Path):
    calib = "cam0=[700 0 50; 0 700 40; 0 0 1]\ncam1=[700 0 55; 0 700 40; 0 0 1]\nbaseline=100\n"
    (tmp_path / "calib.txt").write_text(calib, "utf-8-sig")
    assert read_geometry(tmp_path / "calib.txt").offset == 5
    (tmp_path / "poses.txt").write_text("\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "utf-8-sig")
    assert len(read_poses(tmp_path / "poses.txt").matrices) == 1
    assert json_object(b'\xef\xbb\xbf{"fb": 1}') == {"fb": 1}
