"""Scoring the maps of one scene after another, for every run."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.core.errors import DepthcliError, InputError

if TYPE_CHECKING:
    from depthcli.data.scenes import Scene
    from depthcli.evaluation.protocols import Protocol, Settings
    from depthcli.evaluation.results import Result
    from depthcli.report.page import Page


@dataclass
class Scoring:
    """What stays the same from scene to scene, and the protocols met so far."""

    runs: dict[str, Path]
    truth: Path
    output: Path | None
    judge: Protocol[Any, Any] | None
    settings: Settings
    page: Page | None = None
    judges: dict[str, Protocol[Any, Any]] = field(default_factory=dict)

    @cached_property
    def reports(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Run -> scene -> row of the run's own report."""
        from depthcli.batch.run_folder import read_report

        return {run: read_report(place) for run, place in self.runs.items()}

    def results(self, scene: Scene, alone: bool) -> list[Result]:
        """The results of one scene for every run; ``alone``: no other scene has its short name."""
        from depthcli.evaluation.protocols import load
        from depthcli.evaluation.results import Result

        folder, _, short = scene.name.rpartition("/")
        start = Result("", scene.name, folder or self.truth.resolve().name, "")
        names = [scene.name, f"{self.truth.resolve().name}/{scene.name}", *([short] if alone else [])]
        try:
            scene.check()
            if self.judge is None and not scene.protocol:
                raise InputError(f"{scene.folder}: {scene.name} names no protocol; say which with --protocol")
            judge = self.judge or load(scene.protocol)(self.settings)
            judge = self.judges.setdefault(judge.name, judge)
            start = replace(start, protocol=judge.name)
            truth = judge.truth(scene)
        except DepthcliError as error:
            return [replace(start, run=run, error=str(error)) for run in self.runs]
        if self.page is not None:
            self.page.scene(judge, scene, truth)
        return [self._result(replace(start, run=run), judge, scene, truth, names) for run in self.runs]

    def _result(self, start: Result, judge: Protocol[Any, Any], scene: Scene, truth: Any, names: list[str]) -> Result:
        place, rows = self.runs[start.run], self.reports[start.run]
        row: dict[str, Any] = next((rows[name] for name in names if name in rows), {})
        try:
            path = place if place.is_file() else judge.find(place, names)
            if path is None:
                failed = f": the run failed there: {row.get('error')}" if row.get("error") else judge.looked_for(names)
                raise InputError(f"{place}: no map of scene {scene.name}{failed}")
            estimate = judge.read(path, scene, truth)
        except DepthcliError as error:
            missing, dense = tuple(judge.missing(truth)), tuple(judge.missing(truth, dense=True))
            return replace(start, scores=missing, dense=dense, error=str(error))
        warnings, confidences = judge.warnings(estimate, truth), {}
        for name, file in judge.confidences(path).items():
            try:
                confidences[name] = judge.read_confidence(file, truth)
            except DepthcliError as error:
                warnings.append(str(error))
        result = replace(
            start,
            source=path.name if path == place else path.relative_to(place).as_posix(),
            scores=tuple(judge.scores(estimate, truth)),
            dense=tuple(judge.dense(estimate, truth)),
            curves=tuple(judge.curves(estimate, truth, confidences)),
            seconds=math.fsum(row.get("seconds", {}).values()) or math.nan,
            size=judge.size(truth),
            disparities=top if isinstance(top := row.get("max_disparity"), int) and top > 0 else 0,
            warning="; ".join(warnings),
            evidence=judge.evidence(estimate, truth),
        )
        if self.output is not None:
            draw(result, judge.picture(estimate, truth), self.output)
        if self.page is not None:
            self.page.map(result, path, estimate, truth, confidences)
        return result


def draw(result: Result, picture: Any, output: Path) -> None:
    """Write a result's error picture and the plots of its curves."""
    from depthcli.data.formats.atomic import write_text
    from depthcli.data.formats.images import write_png

    if picture is not None:
        write_png(output / result.picture, picture)
    if not result.curves:
        return
    from depthcli.report.plots import curve_plot

    for (mask, of), path in result.plots.items():
        lines = {c.confidence: c.line for c in result.curves if (c.mask, c.of) == (mask, of)}
        write_text(output / path, curve_plot(lines, f"{result.run}: {result.scene}, {mask}", of))
