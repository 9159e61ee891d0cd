"""What the sub-commands do: find config and scenes, run them, print the result, give the exit code."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from depthcli.batch import record
from depthcli.batch.presets import describe, find_config, leading_comment, list_presets
from depthcli.batch.reporter import Reporter
from depthcli.batch.runner import Options, run_scenes
from depthcli.core.config_file import ConfigData, load_config, validate
from depthcli.core.errors import ConfigError
from depthcli.io.scenes import Scene, find_scenes

if TYPE_CHECKING:
    from depthcli.jobs.evaluate import EvaluationReport

SOME_FAILED = 3

# Command -> module below jobs/, its root config, and what computes one scene.
_BATCHES = {
    "stereo": ("stereo", "StereoConfig", "StereoWork"),
    "fuse": ("fuse", "FuseConfig", "FuseWork"),
}


@dataclass(frozen=True)
class Request:
    """What a batch command was asked to do: ``depthcli COMMAND CONFIG --input DIR --output DIR ...``."""

    config: str
    settings: list[str]
    output: Path
    input: Path | None = None
    left: Path | None = None
    right: Path | None = None
    layout: str | None = None
    scenes: str = "*"
    evaluate: bool = False
    json: bool = False


def root_config(command: str) -> type[BaseModel]:
    """The root config model of a batch command."""
    module, name, _ = _BATCHES[command]
    model: type[BaseModel] = getattr(importlib.import_module(f"depthcli.jobs.{module}"), name)
    return model


def run_batch(command: str, request: Request, options: Options, reporter: Reporter) -> int:
    """Run a batch command and print its table; the exit code.

    Raises
    ------
    DepthcliError
        The config, the options or the input folder cannot be used; nothing was computed.
    """
    config = load_config(root_config(command), find_config(command, request.config), request.settings)
    scenes = _find_scenes(request)
    module, _, work = _BATCHES[command]
    compute = getattr(importlib.import_module(f"depthcli.jobs.{module}"), work)(config)
    rows = run_scenes(command, config, scenes, compute, request.output, options, reporter)
    failed = sum(row["status"] == "failed" for row in rows)
    evaluation = _evaluate_run(request, scenes, reporter) if request.evaluate else None
    if request.json:
        document = record.report_document(command, rows)
        if evaluation is not None:
            document["evaluation"] = evaluation.to_dict()
        print(record.to_json(document), end="")
    else:
        print(_table(rows) if evaluation is None else evaluation.text())
    reporter.info(f"{len(rows) - failed} of {len(rows)} scenes done, in {request.output}")
    return SOME_FAILED if failed or (evaluation is not None and evaluation.failed) else 0


def run_evaluate(
    runs: list[Path],
    truth: Path,
    output: Path,
    scenes: str,
    layout: str | None,
    scale: float | None,
    json: bool,
    reporter: Reporter,
) -> int:
    """Compare runs with the ground truth and print the tables; the exit code."""
    report = _evaluate(runs, truth, output, scenes, layout, scale, reporter)
    print(record.to_json(report.to_dict()) if json else report.text(), end="" if json else "\n")
    reporter.info(f"report and error pictures in {output}")
    return SOME_FAILED if report.failed else 0


def run_sample(
    output: Path, options: dict[str, Any], source: Path | None, overwrite: bool, json: bool, reporter: Reporter
) -> int:
    """Generate scenes, or cross-modal versions of the scenes in ``source``; the exit code."""
    from depthcli.jobs.sample import SampleOptions, write_cross_modal, write_samples

    checked = validate(SampleOptions, ConfigData("depthcli sample", dict(options)))
    if source is not None and not checked.cross_modal:
        raise ConfigError("--from wants --cross-modal")
    if source is None:
        rows = write_samples(output, checked, overwrite=overwrite)
    else:
        rows = write_cross_modal(source, output, seed=checked.seed, speckles=checked.speckles, overwrite=overwrite)
    for row in rows:
        if row.reason:
            reporter.error(f"{row.scene}: {row.reason}")
    if json:
        print(record.to_json({"command": "sample", "scenes": [asdict(row) for row in rows]}), end="")
    else:
        cells = [(row.scene, row.status, f"{row.width}x{row.height}" if row.width else "-") for row in rows]
        print(_aligned([("scene", "status", "size"), *cells]))
    failed = sum(row.status == "failed" for row in rows)
    reporter.info(f"{len(rows) - failed} scenes in {output}")
    return SOME_FAILED if failed else 0


def show_preset(name: str) -> str:
    """A preset as YAML with every field and its description; ``name`` may be ``command/name``.

    A name alone means the first command that has it, in the order of ``_BATCHES``.
    """
    command, _, preset = name.rpartition("/")
    found = [(c, p, about) for c, p, about in list_presets(command or None) if p == preset]
    if not found:
        raise ConfigError(f"no preset called {name!r}; see: depthcli presets")
    # A name that several commands have means the first command's, as in --help; the others are named.
    (command, preset, _), *others = sorted(found, key=lambda entry: list(_BATCHES).index(entry[0]))
    file = find_config(command, preset)
    title = [leading_comment(file.read_text("utf-8"))]
    title.append(f"Use it as it is: depthcli {command} {preset} ...; or save, change and name this text as a file.")
    title += [f"There is another one: depthcli presets show {c}/{p}" for c, p, _ in others]
    return describe(load_config(root_config(command), file), "\n".join(title))


def _find_scenes(request: Request) -> list[Scene]:
    if request.input is not None:
        if request.left is not None or request.right is not None:
            raise ConfigError("--input and --left/--right exclude each other")
        return find_scenes(request.input, request.layout, request.scenes)
    if request.left is None or request.right is None:
        raise ConfigError("want --input DIR, or --left FILE and --right FILE")
    if request.evaluate:
        raise ConfigError("--evaluate wants --input: a single pair has no ground truth")
    return [Scene(request.left.stem, request.left, request.right)]


def _evaluate_run(request: Request, scenes: list[Scene], reporter: Reporter) -> EvaluationReport | None:
    assert request.input is not None
    if not any(scene.disparity_left for scene in scenes):
        reporter.error(f"{request.input}: no ground truth there, nothing to evaluate")
        return None
    target = request.output / "evaluation"
    return _evaluate([request.output], request.input, target, request.scenes, request.layout, None, reporter)


def _evaluate(
    runs: list[Path],
    truth: Path,
    output: Path,
    scenes: str,
    layout: str | None,
    scale: float | None,
    reporter: Reporter,
) -> EvaluationReport:
    from depthcli.jobs.evaluate import evaluate

    with reporter:
        started = False

        def on_scene(name: str, number: int, total: int) -> None:
            nonlocal started
            if not started:
                reporter.start(total, 0, "evaluate")
                started = True
            else:
                reporter.step()

        report = evaluate(runs, truth, output, scenes, layout, scale, on_scene)
    for warning in report.warnings:
        reporter.info(f"warning: {warning}")
    for result in report.failed:
        reporter.error(f"{result.run} {result.scene}: {result.error}")
    return report


def _table(rows: list[dict[str, Any]]) -> str:
    """The rows as an aligned table: what a person looks at first."""
    lines: list[tuple[str, ...]] = [("scene", "status", "size", "density", "seconds", "memory")]
    for row in rows:
        done = row["status"] == "done"
        peak = row["peak_memory"]
        seconds = sum(row["seconds"].values())
        lines.append(
            (
                str(row["scene"]),
                str(row["status"]),
                f"{row['width']}x{row['height']}" if done and "width" in row else "-",
                f"{100 * row['density']:.1f} %" if done and "density" in row else "-",
                f"{seconds:.2f}" if seconds else "-",
                f"{peak / 2**20:.0f} MiB" if peak else "-",
            )
        )
    return _aligned(lines)


def _aligned(lines: Sequence[tuple[str, ...]]) -> str:
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    table = []
    for line in lines:
        cells = [c.ljust(w) if k < 2 else c.rjust(w) for k, (c, w) in enumerate(zip(line, widths, strict=True))]
        table.append("  ".join(cells).rstrip())
    return "\n".join(table)
