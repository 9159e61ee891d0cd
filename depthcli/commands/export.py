"""Pack the maps of a run as a benchmark takes them, checked before a byte is written.

Whatever is wrong with any map is told at once, and nothing is written then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.batch.command import Command, Values
from depthcli.core.errors import ConfigError, DepthcliError, InputError
from depthcli.core.option import Option

if TYPE_CHECKING:
    from depthcli.batch.console import Reporter
    from depthcli.evaluation.benchmarks import Benchmark, Entry

_MOST_NAMED = 12  # scenes in one message


class ExportCommand(Command):
    """``depthcli export RUN --for BENCHMARK --method NAME --output FILE.zip``."""

    @property
    def arguments(self) -> tuple[Option, ...]:
        """The run."""
        return (Option("run", Path, "Run folder, or a folder of others' maps.", "RUN", required=True),)

    @property
    def options(self) -> tuple[Option, ...]:
        """For whom, and under which name."""
        return (
            Option("for_", str, "middlebury-v3, kitti-2012, kitti-2015 or eth3d.", "BENCHMARK", required=True),
            Option("method", str, "Name of the method at the benchmark.", "NAME", required=True),
            Option("output", Path, "The archive to write.", "FILE.zip", short="-o", required=True),
            Option("split", str, "Only the training or only the test scenes.", "training|test"),
            Option("sparse", bool, "Maps with holes, as such (Middlebury).", default=False),
            Option("seconds", float, "Run time of every scene, where the run has no report.", "S", min_value=0.0),
            Option("overwrite", bool, "Replace the archive.", default=False),
        )

    def run(self, values: Values, reporter: Reporter) -> int:
        """Check, then write; the exit code.

        Raises
        ------
        ConfigError
            Anything that the benchmark would not take, all of it, a line each.
        """
        from depthcli.batch.json_csv import to_json
        from depthcli.evaluation.benchmarks import Submission, benchmark

        target, bench = values["output"], benchmark(values["for_"])
        if target.exists() and not values["overwrite"]:
            raise ConfigError(f"{target}: is there already; choose another --output, or --overwrite it")
        problems = [f"--method: {wrong}"] if (wrong := bench.check_name(values["method"])) else []
        splits = _splits(bench, values["split"])
        entries, missing = _entries(values["run"], bench, splits, values["seconds"])
        problems += missing
        sizes: dict[str, tuple[int, int]] = {}
        start = Submission(values["method"], values["sparse"])
        with reporter:
            reporter.start(len(entries), 0, "check")
            for entry in entries:
                try:
                    found = _load(entry)
                    problems += [f"{entry.scene}: {reason}" for reason in bench.problems(entry, found, start)]
                    sizes[entry.scene] = (found.shape[1], found.shape[0])
                except DepthcliError as error:
                    problems.append(f"{entry.scene}: {error}")
                reporter.step()
        submission = Submission(values["method"], values["sparse"], sizes)
        problems += bench.whole(submission)
        if problems:
            head = f"{values['run']}: not as {values['for_']} takes it, nothing written:"
            raise ConfigError("\n".join([head, *(f"  {line}" for line in problems)]))
        unsure = [entry.scene for entry in entries if entry.size is None]
        if unsure:
            reporter.info(f"sizes not checked, as the images are not known: {_some(unsure)}")
        names = _write(target, ((entry, bench.files(entry, _load(entry), submission)) for entry in entries))
        parts = ", ".join(
            f"{sum(e.split == s for e in entries)} {s}" for s in splits if any(e.split == s for e in entries)
        )
        reporter.info(f"{target}: {len(names)} files, {parts} scenes")
        if values["json"]:
            document = {"benchmark": values["for_"], "method": values["method"], "file": str(target), "files": names}
            reporter.data(to_json(document))
        return 0


def _splits(bench: Benchmark, wanted: str | None) -> list[str]:
    if wanted is not None and wanted not in bench.scenes:
        raise ConfigError(f"--split: want {' or '.join(bench.scenes)} (got {wanted!r})")
    return [wanted] if wanted else list(bench.scenes)


def _entries(
    run: Path, bench: Benchmark, splits: Sequence[str], seconds: float | None
) -> tuple[list[Entry], list[str]]:
    """The maps of the benchmark's scenes, and what is wrong: a split that was begun must be complete."""
    from depthcli.batch.run_folder import read_report
    from depthcli.evaluation.protocols import load

    if not run.is_dir():
        raise InputError(f"{run}: no such folder")
    rows, protocol = read_report(run), load(bench.protocol)()
    found: list[Entry] = []
    problems: list[str] = []
    lacking: dict[str, list[str]] = {}
    for split in splits:
        for scene in bench.scenes[split]:
            names = [name for name in rows if name.rpartition("/")[2] == scene] or [scene]
            if len(names) > 1:
                problems.append(f"{scene}: the run has several of that name: {', '.join(names)}")
                continue
            path, row = protocol.files.find(run, names), rows.get(names[0], {})
            if path is not None:
                found.append(_entry(scene, split, path, row, seconds))
            elif row.get("error"):
                problems.append(f"{scene}: the run failed there: {row['error']}")
            else:
                lacking.setdefault(split, []).append(scene)
    begun = {entry.split for entry in found} or set(splits)
    problems += [
        f"{len(scenes)} of {len(bench.scenes[split])} {split} scenes are missing: {_some(scenes)}"
        for split, scenes in lacking.items()
        if split in begun
    ]
    return found, problems


def _entry(scene: str, split: str, path: Path, row: Mapping[str, Any], seconds: float | None) -> Entry:
    from depthcli.data.formats.headers import image_size
    from depthcli.evaluation.benchmarks import Entry

    measured = sum(row.get("seconds", {}).values()) if seconds is None else seconds
    source = Path(row["source"]) if row.get("source") else None
    size = None
    try:
        if source is not None and source.is_file():
            header = image_size(source)
            size = (header.width, header.height)
    except InputError:
        pass
    if size is None and isinstance(row.get("width"), int) and isinstance(row.get("height"), int):
        size = (row["width"], row["height"])
    return Entry(scene, split, path, measured or float("nan"), source, size)


def _load(entry: Entry) -> Any:
    from depthcli.data.formats.disparity import read_disparity

    return read_disparity(entry.file)


def _write(target: Path, entries: Iterator[tuple[Entry, dict[str, bytes]]]) -> list[str]:
    """An archive of which every byte follows from the files in it: no times, no owners."""
    import zipfile

    from depthcli.data.formats.files import atomic_path

    names: list[str] = []
    with atomic_path(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for _, files in entries:
            for name, data in files.items():
                info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                info.compress_type, info.external_attr, info.create_system = zipfile.ZIP_DEFLATED, 0o644 << 16, 3
                archive.writestr(info, data)
                names.append(name)
    return names


def _some(scenes: Sequence[str]) -> str:
    more = f", and {len(scenes) - _MOST_NAMED} more" if len(scenes) > _MOST_NAMED else ""
    return ", ".join(scenes[:_MOST_NAMED]) + more


COMMAND = ExportCommand()
