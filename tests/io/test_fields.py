"""Every program's fields and transforms against SimpleITK, on a warp that is known."""

import struct
import tempfile
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid, Volume
from depthcli.io.formats.fields import in_millimeters, read_field, read_moving_transform, read_transform
from depthcli.io.formats.volumes import itk_image, write_array
from tests.golden import refused, told, warned

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    SimpleITK = pytest.importorskip("SimpleITK")

GRID = Grid((20, 18, 16), (1.2, 0.9, 2.0), (-30.0, 14.0, 5.0), (-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
POINTS = GRID.to_point(np.array([[4.0, 5.0, 6.0], [8.0, 9.0, 10.0], [10.5, 7.25, 3.5]]))
RAS = np.array([-1, -1, 1], np.float32)
z, y, x = np.meshgrid(*(np.linspace(0, 1, n) for n in GRID.shape), indexing="ij")
FIELD = np.stack([2 + 2 * np.sin(3 * y), -1.5 + z, 3 * x - 1], axis=-1).astype(np.float32)  # mm, LPS
IN_VOXELS = (FIELD @ GRID.axes) / np.array(GRID.spacing)
POSITIONS = (GRID.to_point(np.indices(GRID.shape, float).reshape(3, -1).T).reshape(FIELD.shape) + FIELD) * RAS
WARP = SimpleITK.DisplacementFieldTransform(itk_image(FIELD.astype(np.float64), GRID))
EMPTY = Volume(np.zeros(GRID.shape, np.float32), GRID)


def same(found, expected, atol):
    """Both map the points alike."""
    for point in POINTS.tolist():
        np.testing.assert_allclose(found.TransformPoint(point), expected.TransformPoint(point), atol=atol)


def volumes(warp=WARP):
    """A fixed volume that the warp makes of the moving one, and that one."""
    wide = np.random.default_rng(0).standard_normal(GRID.shape).astype(np.float32)
    image = SimpleITK.SmoothingRecursiveGaussian(itk_image(wide, GRID), 2.0)
    warped = SimpleITK.Resample(image, image, warp, SimpleITK.sitkLinear)
    return (Volume(SimpleITK.GetArrayFromImage(each), GRID) for each in (warped, image))


def nifti(path, values, name=b"", p1=0.0, dims=5, grid=GRID):
    """A NIfTI file of the components as given, with the intent of a vector."""
    write_array(path, grid, np.zeros((*grid.shape, 3), np.float32))
    data = bytearray(path.read_bytes()[:352])
    x, y, z = grid.size
    struct.pack_into("<8h", data, 40, *((5, x, y, z, 1, 3, 1, 1) if dims == 5 else (4, x, y, z, 3, 1, 1, 1)))
    struct.pack_into("<h", data, 68, 1007 if dims == 5 else 0)
    struct.pack_into("<f", data, 56, p1)
    data[328 : 328 + len(name)] = name
    path.write_bytes(bytes(data) + np.ascontiguousarray(np.moveaxis(values, -1, 0), "<f4").tobytes())
    return path


def voxelmorph(path, values):
    np.savez(path, values.transpose(2, 1, 0, 3).astype(np.float16).astype(np.float32))


def itk(path, values):
    write_array(path, GRID, values)


# What programs write of the displacement: the file, how, its values; and the convention that is found in it.
KINDS = {
    ".mha": ("field.mha", itk, FIELD, "itk"),
    ".nrrd": ("field.nrrd", itk, FIELD, "itk"),
    ".nii.gz": ("field.nii.gz", itk, FIELD, "itk"),
    "ants": ("field.nii", nifti, FIELD, "itk"),
    "niftyreg displacement": ("field.nii", partial(nifti, name=b"NREG_TRANS", p1=1.0), FIELD * RAS, "niftyreg"),
    "niftyreg positions": ("field.nii", partial(nifti, name=b"NREG_TRANS", p1=0.0), POSITIONS, "positions"),
    "spm": ("field.nii", partial(nifti, name=b"Mapping"), POSITIONS, "positions"),
    "learn2reg": ("field.nii", partial(nifti, dims=4), IN_VOXELS, "voxels"),
    "voxelmorph": ("disp.npz", voxelmorph, IN_VOXELS, "voxels"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_field_says_what_it_is_and_maps_points_as_simpleitk_does(tmp_path, kind):
    name, write, values, named = KINDS[kind]
    write(tmp_path / name, values)
    field = read_field(tmp_path / name, GRID)
    assert field.named == named
    slack = 5e-3 if kind == "voxelmorph" else 1e-4
    np.testing.assert_allclose(in_millimeters(field, field.named), FIELD, atol=slack)
    same(read_moving_transform(None, tmp_path / name, "auto", *volumes()), WARP, 1e-2)


def test_auto_refuses_what_another_reading_explains_better(tmp_path):
    fixed, moving = volumes()
    wrong = nifti(tmp_path / "field.nii", FIELD * RAS)  # NiftyReg's numbers under ANTs' header
    refused(InputError, read_moving_transform, None, wrong, "auto", fixed, moving)
    same(read_moving_transform(None, wrong, "niftyreg", fixed, moving), WARP, 1e-3)
    nifti(wrong, IN_VOXELS)  # voxels under a header that says mm
    refused(InputError, read_moving_transform, None, wrong, "auto", fixed, moving)
    nameless = nifti(tmp_path / "y_f.nii", POSITIONS)
    refused(InputError, read_moving_transform, None, nameless, "auto", moving, fixed)  # exchanged: none fits well
    same(read_moving_transform(None, nameless, "positions", fixed, moving), WARP, 1e-3)


def check(file, expected, field=None, atol=1e-6):
    same(read_moving_transform(file, field, "auto", EMPTY, None), expected, atol)


MATRIX = [1.02, 0.05, 0.0, -0.04, 0.98, 0.03, 0.01, 0.0, 1.1]
AFFINE = SimpleITK.AffineTransform(MATRIX, [2.0, -3.0, 1.0], [-20.0, 10.0, 15.0])
SPLINE = SimpleITK.BSplineTransform(3, 3)
SPLINE.SetTransformDomainOrigin((-60.0, 5.0, 0.0))
SPLINE.SetTransformDomainPhysicalDimensions((60.0, 40.0, 50.0))
SPLINE.SetTransformDomainMeshSize((4, 3, 3))
SPLINE.SetParameters((4 * np.random.default_rng(1).standard_normal(len(SPLINE.GetParameters()))).tolist())


@pytest.mark.parametrize("suffix", [".tfm", ".txt", ".h5", ".mat"])
def test_itk_transform_files(tmp_path, suffix):
    file = tmp_path / f"t{suffix}"
    SimpleITK.WriteTransform(AFFINE, str(file))
    check(file, AFFINE)
    composed = SimpleITK.CompositeTransform([AFFINE, WARP])  # as of ANTs: an affine after its warp
    check(file, composed, nifti(tmp_path / "field.nii", FIELD), 1e-4)
    if suffix != ".mat":  # a B-spline, such as of elastix, given as the displacement
        check(None, AFFINE, file)


def elastix(path, name, parameters, initial="NoInitialTransform", **fields):
    lines = [f'(Transform "{name}")', f"(TransformParameters {numbers(parameters)})",
             f'(InitialTransformParametersFileName "{initial}")', '(HowToCombineTransforms "Compose")',
             "(FixedImageDimension 3)"]  # fmt: skip
    lines += [f"({key} {value})" for key, value in fields.items()]
    path.write_text("// a comment\n" + "\n".join(lines) + "\n")
    return path


def numbers(values):
    return " ".join(f"{v:.12g}" for v in values)


def test_elastix_transforms_one_by_one_and_in_chains(tmp_path):
    center = {"CenterOfRotationPoint": "-20 10 15"}
    for name, expected, fields in (
        ("TranslationTransform", SimpleITK.TranslationTransform(3, [1.0, -2.0, 3.0]), {}),
        ("EulerTransform", SimpleITK.Euler3DTransform([-20.0, 10.0, 15.0], 0.1, -0.05, 0.2, [1.0, 2.0, 3.0]),
         center | {"ComputeZYX": '"false"'}),
        ("AffineTransform", AFFINE, center),
    ):  # fmt: skip
        check(elastix(tmp_path / "TransformParameters.0.txt", name, expected.GetParameters(), **fields), expected)
    grid = SPLINE.GetCoefficientImages()[0]
    second = elastix(tmp_path / "TransformParameters.1.txt", "BSplineTransform", SPLINE.GetParameters(),
                     "/elsewhere/TransformParameters.0.txt", GridSize=numbers(grid.GetSize()), GridIndex="0 0 0",
                     GridSpacing=numbers(grid.GetSpacing()), GridOrigin=numbers(grid.GetOrigin()),
                     GridDirection="1 0 0 0 1 0 0 0 1", BSplineTransformSplineOrder="3")  # fmt: skip
    check(second, SimpleITK.CompositeTransform([SPLINE, AFFINE]))
    spline = {"GridSize": "1 1 1", "GridSpacing": "1 1 1", "GridOrigin": "0 0 0"}
    for name, initial, fields in (
        ("TranslationTransform", "t.txt", {}),  # a circle
        ("TranslationTransform", "u.txt", {"HowToCombineTransforms": '"Add"'}),
        ("TranslationTransform", "NoInitialTransform", {"FixedImageDimension": "2"}),
        ("SplineKernelTransform", "NoInitialTransform", {}),
        ("BSplineTransform", "NoInitialTransform", spline | {"BSplineTransformSplineOrder": "4"}),
        ("BSplineTransform", "NoInitialTransform", spline | {"GridSpacing": "1 0 1"}),
    ):
        file = elastix(tmp_path / "t.txt", name, [1.0, 2.0, 3.0], initial, **fields)
        refused(InputError, read_moving_transform, file, None, "auto", EMPTY, None)


def test_fields_that_cannot_be_read_or_used_are_named_once(tmp_path):
    SimpleITK.WriteImage(SimpleITK.Image([4, 4, 4], SimpleITK.sitkVectorFloat32, 2), str(tmp_path / "two.mha"))
    kinds = (3.0, 4.0, 5.0, 7.0, 0.4)  # of NiftyReg: velocities, and unknown ones
    others = [nifti(tmp_path / f"{kind}.nii", FIELD, b"NREG_TRANS", kind) for kind in kinds]
    (tmp_path / "cut.npz").write_bytes(b"PK\3\4")
    np.savez(tmp_path / "flat.npz", FIELD[0])
    np.savez(tmp_path / "several.npz", FIELD, FIELD)
    write_array(tmp_path / "own.nrrd", GRID, FIELD)
    for name, frame in (("same", b"(1,0,0) (0,1.0,0) (0,0,1)"), ("turned", b"(0,1,0) (-1,0,0) (0,0,1)")):
        data = (tmp_path / "own.nrrd").read_bytes().replace(b"kinds:", b"measurement frame: " + frame + b"\nkinds:", 1)
        (tmp_path / f"{name}.nrrd").write_bytes(data)
    np.testing.assert_array_equal(read_field(tmp_path / "same.nrrd", GRID).values, FIELD)
    named = [tmp_path / name for name in ("two.mha", "none.mha", "cut.npz", "flat.npz", "several.npz", "turned.nrrd")]
    for file in (*named, *others):
        assert refused(InputError, read_field, file, GRID).count(file.name) == 1
    np.savez(tmp_path / "more.npz", flow=IN_VOXELS.transpose(3, 2, 1, 0), seconds=np.ones(2))
    field, lines = warned(read_field, tmp_path / "more.npz", GRID)
    np.testing.assert_array_equal(field.values, IN_VOXELS.astype(np.float32))
    assert len(lines) == 1 and "'flow' is read, not seconds" in lines[0]
    values = FIELD.copy()
    values[3, 4, 5, 1], values[6] = np.nan, np.inf
    for name, write in (("itk.mha", itk), ("itk.nii", nifti), ("voxels.nii", partial(nifti, dims=4))):
        write(tmp_path / name, values)
        assert refused(InputError, read_moving_transform, None, tmp_path / name, "auto", *volumes()).count(name) == 1


@pytest.mark.parametrize("convention", ["auto", "itk"])
def test_what_fits_better_the_other_way_round_is_said(tmp_path, convention):
    inverse = SimpleITK.InvertDisplacementField(itk_image(FIELD.astype(np.float64), GRID), 50)
    inverted = SimpleITK.GetArrayFromImage(inverse)  # of a registration of the moving volume to the fixed one
    for field, way in ((FIELD, None), (inverted.astype(np.float32), "inverted"), (-FIELD, "negated")):
        itk(tmp_path / "field.mha", field)
        _, lines = warned(read_moving_transform, None, tmp_path / "field.mha", convention, *volumes())
        assert ["field.mha" in line and str(way) in line for line in lines] == [True] * (way is not None)
    moving, fixed = volumes(AFFINE)
    for transform, is_wrong in ((AFFINE.GetInverse(), False), (AFFINE, True)):
        SimpleITK.WriteTransform(transform, str(tmp_path / "t.tfm"))
        _, lines = warned(read_moving_transform, tmp_path / "t.tfm", None, convention, fixed, moving)
        assert ["inverted" in line for line in lines] == [True] * is_wrong


def lines_about(values, grid):
    """What is said of a field, (Z, Y, X, 3) mm on ``grid``, of the known volumes."""
    with tempfile.TemporaryDirectory() as folder:
        write_array(Path(folder, "field.mha"), grid, values.astype(np.float32))
        return warned(read_moving_transform, None, Path(folder, "field.mha"), "itk", *volumes())[1]


def test_a_field_that_does_not_belong_to_the_volumes_is_said():
    near, far = (replace(GRID, origin=(GRID.origin[0] + mm, *GRID.origin[1:])) for mm in (-8.0, 500.0))
    assert not lines_about(FIELD, GRID)
    told(lines_about(FIELD, near)[0])
    refused(InputError, lines_about, FIELD, far)
    assert "unit mm" in lines_about(FIELD / 1000, GRID)[0]
    assert "left out" in lines_about(np.random.default_rng(0).uniform(-8, 8, FIELD.shape), GRID)[0]
    refused(InputError, lines_about, FIELD + 500, GRID)


@pytest.mark.parametrize(("order", "kind"), [(3, 2.0), (1, 6.0)])
def test_control_points_of_niftyreg(tmp_path, order, kind):
    spacing = (4.0, 4.0, 5.0)
    start = GRID.to_point(np.array([[0.0, 0, 0]]))[0] - GRID.axes @ np.array(spacing)
    grid = Grid((9, 8, 11), spacing, tuple(start), GRID.direction)
    shifts = np.random.default_rng(0).uniform(-3, 3, (*grid.shape, 3))
    places = grid.to_point(np.indices(grid.shape, float).reshape(3, -1).T).reshape(shifts.shape)
    file = nifti(tmp_path / "cpp.nii", (places + shifts) * RAS, b"NREG_TRANS", kind, grid=grid)
    parts = [itk_image(np.ascontiguousarray(shifts[..., axis]), grid) for axis in range(3)]
    for convention in ("auto", "niftyreg"):
        found = read_moving_transform(None, file, convention, EMPTY, None)
        same(found, SimpleITK.BSplineTransform(parts, order), 1e-4)
    refused(InputError, read_moving_transform, None, file, "itk", EMPTY, None)


def test_elastix_without_direction_cosines(tmp_path):
    turned = Grid(GRID.size, GRID.spacing, (4.0, 2.0, 1.0), (0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0))
    parameters = [1, 0.1, 0, 0, 1.05, 0, 0.02, 0, 1, 5, -4, 3]
    fields = {"CenterOfRotationPoint": "1 2 3", "UseDirectionCosines": '"false"'}
    file = elastix(tmp_path / "t.txt", "AffineTransform", parameters, **fields)
    own = elastix(tmp_path / "u.txt", "AffineTransform", parameters, CenterOfRotationPoint="1 2 3")
    transform, plain = (read_transform(file, (GRID, turned)), read_transform(own, (GRID, turned)))
    for index in ([3.0, 4.0, 5.0], [8.0, 1.0, 9.0]):
        at = np.array(index[::-1]) * GRID.spacing + GRID.origin  # without the directions
        moved = (np.array(plain.TransformPoint(at.tolist())) - turned.origin) / turned.spacing
        expected = turned.to_point(moved[None, ::-1])[0]
        (point,) = GRID.to_point(np.array([index]))
        np.testing.assert_allclose(transform.TransformPoint(point.tolist()), expected, atol=1e-9)
    refused(InputError, read_moving_transform, file, None, "auto", EMPTY, None)
    cyclic = elastix(tmp_path / "c.txt", "AffineTransform", parameters, UseCyclicTransform='"true"')
    refused(InputError, read_moving_transform, cyclic, None, "auto", EMPTY, replace(EMPTY, grid=turned))
