"""Results for other programs: ``scores.parquet``, and one JSON line a run for trackers of experiments."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli import __version__
from depthcli.core.errors import ConfigError, DepthcliError
from depthcli.core.option import Option
from depthcli.run.command import Values
from depthcli.run.console import Reporter

if TYPE_CHECKING:
    from depthcli.evaluation.comparison import EvaluationReport

OTHER_TOOLS = (
    Option("parquet", bool, "Also write scores.parquet, for data frames.", default=False, group="Output"),
    Option("log", Path, "Append a line of JSON a run, for experiment trackers.", "FILE.jsonl", group="Output"),
)  # fmt: skip

_RUN = "run"  # the key of run.yaml that is not one of the config


def check_other_tools(values: Values) -> None:
    """Raise ConfigError where what the options ``OTHER_TOOLS`` request cannot be written."""
    from depthcli.evaluation.parquet import check_parquet
    from depthcli.run.json_lines import check_lines

    if values["parquet"]:
        if values["output"] is None:
            raise ConfigError("--parquet wants --output, the folder to write scores.parquet into")
        check_parquet()
    if values["log"] is not None:
        check_lines(values["log"])


def scores_parquet(report: EvaluationReport, runs: Mapping[str, Path]) -> bytes:
    """Return ``scores.parquet``: the rows of ``scores.csv``, with versions and digests of configs as metadata."""
    from depthcli.evaluation.parquet import parquet_bytes

    digests = {name: config_digest(place) for name, place in runs.items()}
    return parquet_bytes(
        report.records(), {"version": __version__, "plugins": report.plugins, "config_digests": digests}
    )


def log_runs(report: EvaluationReport, runs: Mapping[str, Path], file: Path, reporter: Reporter) -> None:
    """Append the line of every run to a file, where it is not there yet."""
    from depthcli.run.json_csv import to_json_line
    from depthcli.run.json_lines import add_lines

    lines = [to_json_line(run_line(report, name, place)) for name, place in runs.items()]
    added = add_lines(file, lines, reporter.info)
    reporter.info(f"{file}: {added} of {len(lines)} lines added" + "; the others are there" * (added < len(lines)))


def run_line(report: EvaluationReport, run: str, place: Path) -> dict[str, Any]:
    """Return what a tracker of experiments wants to know of a run, the same at each evaluation.

    ``metrics`` has a number for each ``DATA SET/REGION/METRIC``, the mean over all scenes, and the run's single figure
    as that of the region ``overall``; what has no number is left out. ``preset`` is the one that differs least from the
    config, ``changes`` the values of keys that differ. ``config_digest`` is the digest of ``run.yaml``, by which the
    records of the run's scenes know it. These are None, or empty, where no run of depthcli made the maps.
    """
    command, config, versions = _run_file(place)
    preset, changes = _nearest_preset(command, config or {})
    metrics: dict[str, float] = {}
    data_sets: dict[str, Any] = {}
    names = [section.data_set for section in report.sections]
    for section in report.sections:
        unique = names.count(section.data_set) == 1
        name = section.data_set if unique else f"{section.data_set} {section.protocol.name}"
        data_sets[name] = {
            "protocol": section.protocol.name, "scenes": len(section.scenes), "missing": section.n_missing(run)
        }  # fmt: skip
        values = {f"{name}/overall/{section.protocol.headline.heading}": section.overall(run).value}
        for metric, region in section.keys:
            values.setdefault(f"{name}/{region}/{metric.heading}", section.mean(run, (metric, region)).value)
        metrics |= {key: float(value) for key, value in values.items() if math.isfinite(value)}
    return {
        "run": run, "command": command or None, "preset": preset or None, "changes": changes,
        "config_digest": config_digest(place) or None, "config": config, "data_sets": data_sets, "metrics": metrics,
        "versions": versions, "evaluated_by": {"depthcli": __version__, **report.plugins},
    }  # fmt: skip


def config_digest(place: Path) -> str:
    """Return the digest of a run's ``run.yaml``, the identity in the records of its scenes; empty without one."""
    from depthcli.run.records import digest
    from depthcli.run.run_folder import saved_config

    text = saved_config(place)
    return digest(text.encode()) if text else ""


def _run_file(place: Path) -> tuple[str, dict[str, Any] | None, dict[str, str]]:
    """Command, config and versions by the ``run.yaml`` of a run; empty and None where it has none that can be read."""
    from depthcli.core.config_file import parse_config
    from depthcli.run.run_folder import saved_config

    text = saved_config(place)
    with contextlib.suppress(ConfigError):
        data = parse_config(text, "run.yaml").data if text else {}
        about = data.pop(_RUN, None)
        if isinstance(about, dict):
            versions = about.get("versions")
            known = versions if isinstance(versions, dict) else {}
            return str(about.get("command", "")), data, {str(name): str(value) for name, value in known.items()}
    return "", None, {}


def _nearest_preset(command: str, config: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The preset with the fewest keys that differ from a config, and the values of these; ties go to the first."""
    flat = _flat(config)
    found = {name: _changes(flat, values) for name, values in _presets(command).items()}
    name = min(found, key=lambda each: len(found[each]), default="")
    return (name, found[name]) if name else ("", {})


def _changes(flat: Mapping[str, Any], preset: Mapping[str, Any]) -> dict[str, Any]:
    return {key: flat.get(key) for key in {**flat, **preset} if key not in preset or flat.get(key) != preset[key]}


@cache
def _presets(command: str) -> dict[str, dict[str, Any]]:
    """Preset of a command -> its resolved config, flat."""
    from depthcli.commands import find_command
    from depthcli.core.config_file import dump_config, load_config, parse_config
    from depthcli.run.presets import find_preset, presets

    # Commands without a config have no such method; the class of those with one imports the evaluation.
    model: Any = getattr(find_command(command) if command else None, "config_model", None)
    made: dict[str, dict[str, Any]] = {}
    for preset in presets() if callable(model) else ():
        if preset.command == command:
            with contextlib.suppress(DepthcliError):  # one of a plug-in
                config = load_config(model(), preset.file, find=lambda name: find_preset(command, name))
                made[preset.name] = _flat(parse_config(dump_config(config), preset.name).data)
    return made


def _flat(value: Mapping[str, Any], start: str = "") -> dict[str, Any]:
    """Values by their ``--set`` keys, entries of lists of methods by their number."""
    made: dict[str, Any] = {}
    for key, each in value.items():
        inner = each
        if isinstance(each, list) and any(isinstance(entry, dict) for entry in each):
            inner = {str(number): entry for number, entry in enumerate(each)}
        made |= _flat(inner, f"{start}{key}.") if isinstance(inner, Mapping) else {f"{start}{key}": inner}
    return made
