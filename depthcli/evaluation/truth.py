"""The scenes with ground truth that runs are compared on, of a folder or of a single file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from depthcli.core.errors import InputError
from depthcli.evaluation.protocols import AnyProtocol, Settings, load
from depthcli.io.formats.disparity import read_disparity
from depthcli.io.scenes import RgbdScene, Scene, StereoScene
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes, scenes_with_files
from depthcli.io.scenes.rows import Folder
from depthcli.run.console import Reporter

_DEFAULT_PROTOCOLS = "middlebury-v2", "depth"  # of a truth file in no scene's folder, without --protocol


def scenes_with_truth(
    truth: Path,
    patterns: Sequence[str] = ("*",),
    layout: str | None = None,
    protocol: AnyProtocol | None = None,
    settings: Settings | None = None,
    reporter: Reporter | None = None,
    maps: Iterable[Path] = (),
) -> list[Scene]:
    """Return the scenes of a folder that have ground truth, or cannot be used; or the scene of one file of it.

    InputError if no scene has ground truth.

    Parameters
    ----------
    patterns : shell patterns of scene names
    layout : layout of the folder; None recognizes it
    protocol : by which all are scored, and their kind follows; None: by the protocol of every scene
    maps : files compared with the truth; a name can show that both are depth
    """
    settings, reporter = settings or Settings(), reporter or Reporter(-1)
    if os.path.isfile(truth):
        return [_scene_of_file(truth, protocol, settings, reporter, maps)]
    tried = ALL_KINDS if protocol is None else ALL_KINDS.of_kind(protocol.kind)
    there = discover_scenes(truth, tried, layout, patterns, reporter.info)
    found = [scene for scene in there if scene.problem or scene.has_truth]
    if all(scene.problem for scene in found):
        nothing = f"{truth}: no scene there has ground truth (looked for disp_left, disp0GT.pfm, disp2, ...)"
        lacking = [*filter(None, (scene.lacks_for_truth for scene in there)), nothing]
        raise InputError(found[0].problem if found else lacking[0])
    return found


def _scene_of_file(
    truth: Path, protocol: AnyProtocol | None, settings: Settings, reporter: Reporter, maps: Iterable[Path]
) -> Scene:
    """Return the scene whose truth a file is, or one of that map alone, of meta.json's or the settings' scale."""
    if holding := scenes_with_files([truth], ALL_KINDS):
        return holding[truth]
    if protocol is None:
        of_depth = any(each.name.lower().startswith("depth") for each in (truth, truth.parent, *maps))
        name = _DEFAULT_PROTOCOLS[of_depth]
        what = "depth" if of_depth else "disparities"
        reporter.info(f"{truth}: in no scene's folder; scored as {what}, by {name}, unless --protocol is given")
        protocol = load(name)(settings)
    meta = Folder(truth.parent, truth.stem, "").meta
    common: dict[str, Any] = {"name": truth.stem, "folder": truth.parent, "protocol": protocol.name}
    if issubclass(protocol.kind, StereoScene):
        codes = None if truth.suffix.lower() == ".pfm" else meta.positive("disp_scale") or settings.scale
        decode = partial(read_disparity, asks=not protocol.name.startswith("kitti"))
        return StereoScene(**common, left=truth, disparity_left=truth, disparity_scale=codes, decode=decode)
    if issubclass(protocol.kind, RgbdScene):
        alone = RgbdScene(**common, color=truth, depth=truth, depth_true=truth, depth_scale=settings.scale)
        return alone.with_scale(meta.positive("depth_scale"))
    raise InputError(f"{truth}: {protocol.name} needs a folder of scenes as the ground truth")
