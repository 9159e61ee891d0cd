"""Evaluation of finished runs with a folder of ground truth: find its scenes, score the runs' maps of them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from depthcli.core.errors import InputError
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.map_files import MapNaming
from depthcli.evaluation.protocols import AnyProtocol, Settings, load
from depthcli.evaluation.scoring import Viewer, evaluate_scenes
from depthcli.io.inputs import local
from depthcli.io.layouts.all_kinds import ALL_KINDS
from depthcli.io.scenes import RgbdScene, Scene, StereoScene
from depthcli.io.walk import discover_scenes, scenes_with_files
from depthcli.run.console import Reporter
from depthcli.run.flags import Condition

_DEFAULT_PROTOCOL = "middlebury-v2"  # of a truth file that lies in no scene's folder, without --protocol
_MILLIMETERS = 1000.0  # codes a meter of a depth map that is the truth, if the settings have no scale


def evaluate_runs(
    runs: Sequence[Path | str],
    truth: Path | str,
    output: Path | str | None,
    scenes: Sequence[str] = ("*",),
    layout: str | None = None,
    protocol: str | None = None,
    settings: Settings | None = None,
    reporter: Reporter | None = None,
    viewers: Sequence[Viewer] = (),
    map_options: Mapping[str, MapNaming] | None = None,
    conditions: Sequence[Condition] = (),
) -> EvaluationReport:
    """Evaluate runs as :func:`.scoring.evaluate_scenes`, which says what else is given, written and raised.

    InputError where ``truth`` holds no scenes with ground truth, or no protocol has that name.

    Parameters
    ----------
    truth : folder of scenes with ground truth, or one file of it
    scenes : shell patterns of scene names
    layout : layout of ``truth``; None recognizes it
    protocol : its name; None: what every scene names
    """
    reporter, settings, truth = reporter or Reporter(-1), settings or Settings(), local(truth)
    scored_by = None if protocol is None else load(protocol)(settings)
    if os.path.isfile(truth):
        found = [_scene_of_file(truth, scored_by, settings, reporter)]
    else:
        tried = ALL_KINDS if scored_by is None else ALL_KINDS.of_kind(scored_by.kind)
        found = [s for s in discover_scenes(truth, tried, layout, scenes, reporter.info) if s.problem or s.has_truth]
        if all(scene.problem for scene in found):
            nothing = f"{truth}: no scene there has ground truth (looked for disp_left, disp0GT.pfm, disp2, ...)"
            raise InputError(found[0].problem if found else nothing)
    return evaluate_scenes(runs, found, truth, output, scored_by, settings, reporter, viewers, map_options, conditions)


def _scene_of_file(truth: Path, scored_by: AnyProtocol | None, settings: Settings, reporter: Reporter) -> Scene:
    """Return the scene whose truth a file is, or one of that map without masks, of the settings' scale."""
    if holding := scenes_with_files([truth], ALL_KINDS):
        return holding[truth]
    if scored_by is None:
        reporter.info(f"{truth}: in no scene's folder; scored as {_DEFAULT_PROTOCOL} unless --protocol is given")
        scored_by = load(_DEFAULT_PROTOCOL)(settings)
    common: dict[str, Any] = {"name": truth.stem, "folder": truth.parent, "protocol": scored_by.name}
    if issubclass(scored_by.kind, StereoScene):
        codes = None if truth.suffix.lower() == ".pfm" else settings.scale
        return StereoScene(**common, left=truth, disparity_left=truth, disparity_scale=codes)
    if issubclass(scored_by.kind, RgbdScene):
        scale = settings.scale or _MILLIMETERS
        return RgbdScene(**common, color=truth, depth=truth, depth_true=truth, depth_scale=scale)
    raise InputError(f"{truth}: {scored_by.name} needs a folder of scenes as the ground truth")
