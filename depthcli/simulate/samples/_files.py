"""Scenes to start from, and the files of a generated scene."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import write_png
from depthcli.io.scenes import Scene
from depthcli.io.walk import discover_scenes
from depthcli.simulate.samples import SampleScene


def scenes_from(
    folder: Path, kinds: tuple[type[Scene], ...], settings: dict[str, Any], needs_truth: str = ""
) -> list[SampleScene]:
    """Return a scene to be generated for every scene of ``folder``.

    Parameters
    ----------
    folder, kinds : where to look, and for which scenes
    settings : of every scene
    needs_truth : what a scene without ground truth lacks, where one cannot be used
    """
    scenes = []
    for scene in discover_scenes(folder, kinds):
        truth = {role: getattr(scene, role, None) for role in ("depth_true", "disparity_left", "disparity_right")}
        files = scene.input_files | {role: file for role, file in truth.items() if file is not None}
        files |= {f"mask_{name}": file for name, file in getattr(scene, "masks", {}).items()}
        problem = scene.problem
        if needs_truth and not problem and not scene.has_truth:
            problem = f"{scene.folder}: {needs_truth} to start from"
        scenes.append(
            SampleScene(
                name=scene.name, folder=scene.folder, problem=problem, origin=scene, files=files, settings=settings
            )
        )
    return scenes


def write_files(
    folder: Path, images: Mapping[str, Any], maps: Mapping[str, Any], masks: Mapping[str, Any], end: str = ""
) -> None:
    """Write arrays by name: images as PNG, maps as PFM, masks as PNG of their name behind ``mask_``; None is left out.

    Parameters
    ----------
    end : what all names end with
    """
    for name, image in (*images.items(), *((f"mask_{name}", mask) for name, mask in masks.items())):
        write_png(folder / f"{name}{end}.png", image)
    for name, values in maps.items():
        if values is not None:
            write_pfm(folder / f"{name}{end}.pfm", values)


def write_meta(folder: Path, meta: Mapping[str, Any]) -> None:
    """Write the ``meta.json`` of a scene."""
    write_text(folder / "meta.json", json.dumps(meta, indent=1) + "\n")
