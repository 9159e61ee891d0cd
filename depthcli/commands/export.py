"""Check the maps of a run and pack them for a benchmark.

All that is wrong with the maps is reported together, and nothing is written then.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.errors import ConfigError, DepthcliError, InputError
from depthcli.core.option import Option
from depthcli.run.command import Command, Values
from depthcli.run.console import Reporter
from depthcli.run.json_csv import Row, to_json

if TYPE_CHECKING:
    from depthcli.evaluation.benchmarks import Benchmark, Entry

_MAX_NAMED = 12  # scenes that one message names, which keeps it within a few lines


class ExportCommand(Command):
    """``depthcli export RUN --for BENCHMARK --method NAME --output FILE.zip``."""

    arguments = (Option("run", Path, "Run folder, or a folder of others' maps.", "RUN", required=True, group="Input"),)

    options = (
        Option(
            "for_", str, "middlebury-v3, kitti-2012, kitti-2015 or eth3d.", "BENCHMARK", required=True, group="Output"
        ),
        Option("method", str, "Name of the method at the benchmark.", "NAME", required=True, group="Output"),
        Option("output", Path, "The archive to write.", "FILE.zip", short="-o", required=True, group="Output"),
        Option("split", str, "Only the training or only the test scenes.", "SPLIT", group="Input"),
        Option("sparse", bool, "Submit maps with holes as sparse ones (Middlebury).", default=False, group="Output"),
        Option(
            "seconds", float, "Run time of every scene, where the run has no report.", "S", min_value=0.0, group="Input"
        ),
        Option("overwrite", bool, "Replace the archive.", default=False, group="Output"),
    )

    page = "how_to/submit"
    examples = ("depthcli export runs/accurate --for eth3d --method accurate -o eth3d.zip",)

    def run(self, values: Values, reporter: Reporter) -> int:
        """Check all maps, then write them; return the exit code.

        Raises
        ------
        ConfigError
            The benchmark would not take the maps: all reasons, one per line.
        """
        from depthcli.evaluation.benchmarks import Submission, benchmark
        from depthcli.io.formats.disparity import read_disparity
        from depthcli.io.formats.files import collected_warnings, remove_temporaries

        target, bench = values["output"], benchmark(values["for_"])
        if os.path.exists(target) and not values["overwrite"]:
            raise ConfigError(f"{target}: is there already; choose another --output, or --overwrite it")
        problems = [f"--method: {wrong}"] if (wrong := bench.check_name(values["method"])) else []
        if values["split"] is not None and values["split"] not in bench.scenes:
            raise ConfigError(f"--split: want {' or '.join(bench.scenes)} (got {values['split']!r})")
        splits = [values["split"]] if values["split"] else list(bench.scenes)
        entries, missing = _find_maps(values["run"], bench, splits, values["seconds"])
        problems += missing
        sizes: dict[str, tuple[int, int]] = {}
        submission = Submission(values["method"], values["sparse"], sizes)
        with reporter:
            reporter.start(len(entries), 0, "check")
            for entry in entries:
                try:
                    with collected_warnings() as lines:
                        disparity = read_disparity(entry.file)
                    problems += [f"{entry.scene}: {reason}" for reason in bench.problems(entry, disparity, submission)]
                    sizes[entry.scene] = (disparity.shape[1], disparity.shape[0])
                except DepthcliError as error:
                    problems.append(f"{entry.scene}: {error}")
                for line in lines:
                    reporter.info(f"warning: {line}")
                reporter.step()
        problems += bench.problems_together(submission)
        if problems:
            head = f"{values['run']}: not as {values['for_']} takes it, nothing written:"
            raise ConfigError("\n".join([head, *(f"  {line}" for line in problems)]))
        if unknown := [entry.scene for entry in entries if entry.size is None]:
            reporter.info(f"sizes not checked, as the images are not known: {_named(unknown)}")
        files = (bench.files(entry, read_disparity(entry.file), submission) for entry in entries)
        remove_temporaries(target.parent, target.name)
        names = _write_archive(target, files)
        counts = {split: sum(entry.split == split for entry in entries) for split in splits}
        parts = ", ".join(f"{n} {split}" for split, n in counts.items() if n)
        reporter.info(f"{target}: {len(names)} files, {parts} scenes")
        if values["json"]:
            document = {"benchmark": values["for_"], "method": values["method"], "file": str(target), "files": names}
            reporter.data(to_json(document))
        return 0


def _find_maps(
    run: Path, bench: Benchmark, splits: Sequence[str], seconds: float | None
) -> tuple[list[Entry], list[str]]:
    """The maps of the benchmark's scenes, and what is wrong: a split of which one scene is there must be complete."""
    from depthcli.evaluation.protocols import load
    from depthcli.run.reports import read_report

    if not os.path.isdir(run):
        raise InputError(f"{run}: no such folder")
    rows, files = read_report(run), load(bench.protocol).files
    entries: list[Entry] = []
    problems: list[str] = []
    missing: dict[str, list[str]] = {}
    for split in splits:
        for scene in bench.scenes[split]:
            names = [name for name in rows if name.rpartition("/")[2] == scene] or [scene]
            if len(names) > 1:
                problems.append(f"{scene}: the run has several of that name: {', '.join(names)}")
                continue
            path, row = files.find(run, names), rows.get(names[0], {})
            if path is not None:
                entries.append(_entry(scene, split, path, row, seconds))
            elif row.get("error"):
                problems.append(f"{scene}: the run failed there: {row['error']}")
            else:
                missing.setdefault(split, []).append(scene)
    begun = {entry.split for entry in entries} or set(splits)
    problems += [
        f"{len(scenes)} of {len(bench.scenes[split])} {split} scenes are missing: {_named(scenes)}"
        for split, scenes in missing.items()
        if split in begun
    ]
    return entries, problems


def _entry(scene: str, split: str, path: Path, row: Row, seconds: float | None) -> Entry:
    from depthcli.evaluation.benchmarks import Entry
    from depthcli.io.formats.images import image_size

    measured = sum(row.get("seconds", {}).values()) if seconds is None else seconds
    image = Path(row["source"]) if row.get("source") else None
    size = None
    try:
        if image is not None and os.path.isfile(image):
            height, width = image_size(image)
            size = (width, height)
    except InputError:
        pass
    if size is None and isinstance(row.get("width"), int) and isinstance(row.get("height"), int):
        size = (row["width"], row["height"])
    return Entry(scene, split, path, measured or math.nan, image, size)


def _write_archive(target: Path, maps: Iterable[dict[str, bytes]]) -> list[str]:
    """Write the files of all maps without times or owners, so that the same maps give the same bytes."""
    import zipfile

    from depthcli.io.formats.files import atomic_path

    names: list[str] = []
    with atomic_path(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for files in maps:
            for name, data in files.items():
                info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
                info.compress_type, info.external_attr, info.create_system = zipfile.ZIP_DEFLATED, 0o644 << 16, 3
                archive.writestr(info, data)
                names.append(name)
    return names


def _named(scenes: Sequence[str]) -> str:
    more = f", and {len(scenes) - _MAX_NAMED} more" if len(scenes) > _MAX_NAMED else ""
    return ", ".join(scenes[:_MAX_NAMED]) + more


COMMAND = ExportCommand()
