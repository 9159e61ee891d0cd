"""The layout of registered volumes, and the pair that a command's options name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.files import warn
from depthcli.io.scenes.kinds import LEFT_OUT, Scene, VolumePairScene
from depthcli.io.scenes.rows import Folder, Layout, Layouts, name_of_file

_VOLUMES = (".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr", ".img", ".png", ".jpg", ".jpeg")
_FIELDS = (".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr", ".npz", ".h5")
_TRANSFORMS = (".tfm", ".txt", ".h5", ".hdf5", ".mat", ".xfm")
_POINTS = (".csv", ".txt", ".pts", ".fcsv")
_SUFFIXES = {
    "fixed": _VOLUMES, "moving_warped": _VOLUMES, "moving": _VOLUMES, "displacement": _FIELDS, "transform": _TRANSFORMS,
    "mask": _VOLUMES, "landmarks_fixed": _POINTS, "landmarks_moving": _POINTS, "error_true": _VOLUMES,
}  # fmt: skip


class Registration(Layout):
    """One folder per pair; the names of its files give their roles."""

    name = "registration"
    kind = VolumePairScene
    protocol = "registration"
    about = (
        "`fixed.*` and `moving_warped.*`, or `moving.*` with `displacement.*` or `transform.*` (NIfTI, MHA/MHD, NRRD, "
        "DIR-Lab `.img`, PNG, JPEG); where known `mask.*`, `landmarks_fixed.csv` with `landmarks_moving.csv` (x, y, z "
        "in mm), `error_true.*` (mm), `mask_<region>.*` of regions that are reported apart, or a label map of several; "
        "`meta.json` (`apply`: displacement, transform or both, where there are both; `labels`: see the manual)"
    )
    needs = ("fixed.*|moving_warped.*",)

    def scenes(self, folder: Folder) -> list[Scene]:
        files = {role: folder.one(role, suffixes) for role, suffixes in _SUFFIXES.items()}
        fixed, warped, displacement, transform = map(files.get, ("fixed", "moving_warped", "displacement", "transform"))
        if fixed is None and warped is None:
            return []
        problem, apply = "", folder.meta.text("apply", "")
        if fixed is None:
            problem = f"{folder.path}: no fixed.*"
            files["fixed"] = folder.path / "fixed.mha"
        elif warped is None and files["moving"] is None:
            problem = f"{folder.path}: neither moving_warped.* nor moving.*"
        elif warped is None and displacement is None and transform is None:
            problem = f"{folder.path}: moving.* needs displacement.* or transform.*, too"
        elif displacement is not None and transform is not None:
            if apply not in LEFT_OUT:
                problem = (
                    f"{folder.path}: both {displacement.name} and {transform.name}; take away the one that is not the "
                    'registration, or say in meta.json which counts: "apply": "displacement", "transform" or "both"'
                )
            elif LEFT_OUT[apply]:
                files[LEFT_OUT[apply]] = None
        stems = sorted({name.partition(".")[0] for name in folder.names if re.match(r"mask_[^.]+\.", name)})
        found = ((stem.removeprefix("mask_"), folder.one(stem, _VOLUMES)) for stem in stems)
        regions = tuple((name, file) for name, file in found if file is not None)
        labels = _labels(folder, [name for name, _ in regions])
        return [self.scene(folder, problem=problem, regions=regions, labels=labels, **files)]


def _labels(folder: Folder, maps: Sequence[str]) -> tuple[tuple[str, tuple[tuple[str, int], ...]], ...]:
    """Return label map -> region -> label, from ``labels`` of meta.json; background (0) is left out."""
    given = folder.meta.fields.get("labels", {})
    wanted = 'the regions of each mask, such as {"organs": {"liver": 1, "spleen": 2}} of mask_organs.*'
    if not isinstance(given, dict):
        raise folder.meta.error("labels", wanted)
    for name in given:
        if name not in maps:  # no error: one meta.json may describe all pairs, and some may lack a mask
            warn(f"{folder.meta.path}: labels: there is no mask_{name}.*")
    for regions in given.values():
        if not isinstance(regions, dict) or any(type(label) is not int or label < 0 for label in regions.values()):
            raise folder.meta.error("labels", wanted)
        if wrong := [name for name in regions if not name.strip() or set(name) & set("<>=!()")]:
            raise InputError(f"{folder.meta.path}: labels: expected a name without <>=!() (got {wrong[0]!r})")
        if len(set(regions.values())) < len(regions):
            raise InputError(f"{folder.meta.path}: labels: two regions have one label")
    used = {name: tuple((region, k) for region, k in given[name].items() if k) for name in given if name in maps}
    return tuple(used.items())


VOLUMES = Layouts.of(VolumePairScene, Registration())


def named_volumes(values: Mapping[str, Any]) -> list[Scene]:
    """Return the pair of ``fixed`` and ``warped``, or of ``fixed`` and ``moving`` with its transform, in a list.

    The list is empty without these options.
    """
    roles = {"warped": "moving_warped"} | {name: name for name in ("moving", "displacement", "transform", "mask")}
    files: dict[str, Any] = {role: values[name] for name, role in roles.items() if values.get(name) is not None}
    fixed, apply = values.get("fixed"), values.get("apply")
    both = {"displacement", "transform"} <= files.keys()
    if apply is not None and not (both and apply in LEFT_OUT):
        raise ConfigError(f"--apply: expected {', '.join(LEFT_OUT)}, of a pair with --displacement and --transform")
    if fixed is None:
        if files:
            raise ConfigError(f"--{next(n for n in roles if roles[n] in files)} needs --fixed, too")
        return []
    if "moving_warped" not in files and not ("moving" in files and files.keys() & {"displacement", "transform"}):
        raise ConfigError("--fixed needs --warped, or --moving with --displacement or --transform")
    if both and apply is None:
        raise ConfigError("both --displacement and --transform: leave one out, or say which counts by --apply")
    files.pop(LEFT_OUT.get(apply or "", ""), None)
    return [VolumePairScene(name=name_of_file(fixed, "fixed"), folder=fixed.parent, fixed=fixed, **files)]
