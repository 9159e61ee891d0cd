"""Our own layout of registered volumes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.files import warn
from depthcli.io.layouts.base import Folder, Layout
from depthcli.io.scenes import LEFT_OUT, Scene, VolumePairScene

_VOLUMES = (".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr", ".img", ".png", ".jpg", ".jpeg")
_FIELDS = (".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr", ".npz", ".h5")
_TRANSFORMS = (".tfm", ".txt", ".h5", ".hdf5", ".mat", ".xfm")
_POINTS = (".csv", ".txt", ".pts")


class Registration(Layout):
    """One folder per pair; the name of each file says what it holds."""

    kind = VolumePairScene
    protocol = "registration"
    wants = (
        "`fixed.*` and `moving_warped.*`, or `moving.*` with `displacement.*` or `transform.*` (NIfTI, MHA/MHD, NRRD, "
        "DIR-Lab `.img`, PNG, JPEG); where known `mask.*`, `landmarks_fixed.csv` with `landmarks_moving.csv` (x, y, z "
        "in mm), `error_true.*` (mm), `mask_<region>.*` of regions that are reported apart, or a label map of several; "
        "`meta.json` (`apply`: displacement, transform or both, where there are both; `labels`: see the manual)"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        fixed = _one(folder, "fixed", _VOLUMES)
        warped = _one(folder, "moving_warped", _VOLUMES)
        moving = _one(folder, "moving", _VOLUMES)
        if fixed is None and warped is None:
            return []
        displacement, transform = _one(folder, "displacement", _FIELDS), _one(folder, "transform", _TRANSFORMS)
        problem, apply = "", folder.meta.text("apply", "")
        if fixed is None:
            problem = f"{folder.path}: no fixed.*"
        elif warped is None and moving is None:
            problem = f"{folder.path}: neither moving_warped.* nor moving.*"
        elif warped is None and displacement is None and transform is None:
            problem = f"{folder.path}: moving.* wants displacement.* or transform.* beside it"
        elif displacement is not None and transform is not None:
            if apply not in LEFT_OUT:
                problem = (
                    f"{folder.path}: both {displacement.name} and {transform.name}; take away the one that is not the "
                    'registration, or say in meta.json which counts: "apply": "displacement", "transform" or "both"'
                )
            left_out = LEFT_OUT.get(apply)
            displacement = None if left_out == "displacement" else displacement
            transform = None if left_out == "transform" else transform
        return [
            self.scene(
                folder, problem=problem, fixed=fixed or folder.path / "fixed.mha", moving_warped=warped, moving=moving,
                transform=transform, displacement=displacement, mask=_one(folder, "mask", _VOLUMES),
                regions=(regions := _regions(folder)), labels=_labels(folder, [name for name, _ in regions]),
                landmarks_fixed=_one(folder, "landmarks_fixed", _POINTS),
                landmarks_moving=_one(folder, "landmarks_moving", _POINTS),
                error_true=_one(folder, "error_true", _VOLUMES),
            )
        ]  # fmt: skip


def _regions(folder: Folder) -> tuple[tuple[str, Path], ...]:
    """The masks ``mask_<region>.*`` by the names of their regions."""
    stems = {name.partition(".")[0] for name in folder.names if name.startswith("mask_") and "." in name}
    found = ((stem.removeprefix("mask_"), _one(folder, stem, _VOLUMES)) for stem in sorted(stems))
    return tuple((name, file) for name, file in found if name and file is not None)


def _labels(folder: Folder, maps: Sequence[str]) -> tuple[tuple[str, tuple[tuple[str, int], ...]], ...]:
    """Return the names of the labels of each label map, by ``labels`` of meta.json: map -> region -> label."""
    given = folder.meta.fields.get("labels", {})
    wanted = 'the regions of each mask, such as {"organs": {"liver": 1, "spleen": 2}} of mask_organs.*'
    if not isinstance(given, dict):
        raise folder.meta.error("labels", wanted)
    for name in given:
        if name not in maps:  # one meta.json may be that of all pairs, of which some lack a mask
            warn(f"{folder.meta.path}: labels: there is no mask_{name}.* beside it")
    for regions in given.values():
        if not isinstance(regions, dict) or any(type(label) is not int or label < 0 for label in regions.values()):
            raise folder.meta.error("labels", wanted)
        if wrong := [name for name in regions if not name.strip() or set(name) & set("<>=!()")]:
            raise InputError(f"{folder.meta.path}: labels: want a name without <>=!() (got {wrong[0]!r})")
        if len(set(regions.values())) < len(regions):
            raise InputError(f"{folder.meta.path}: labels: two regions have one label")
    used = {name: tuple((region, k) for region, k in given[name].items() if k) for name in given if name in maps}
    return tuple(used.items())


def _one(folder: Folder, stem: str, suffixes: tuple[str, ...]) -> Path | None:
    """The file of that stem and one of the endings, of which ``.nii.gz`` has two parts."""
    fitting = sorted(
        name for name in folder.names if name.startswith(f"{stem}.") and name[len(stem) :].lower() in suffixes
    )
    if len(fitting) > 1:
        raise InputError(f"{folder.path}: both {fitting[0]} and {fitting[1]}; keep one")
    return folder.path / fitting[0] if fitting else None
