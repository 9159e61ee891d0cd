"""Check the maps of a run and pack them for a benchmark.

If there are problems with the maps, all are reported together, and nothing is written.

Examples:
  depthcli export runs/accurate --for eth3d --method accurate -o eth3d.zip
"""

from __future__ import annotations

import contextlib
import math
import os
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from typer import Argument, Option

from depthcli.commands._options import Printing, local_output
from depthcli.core.errors import ConfigError, DepthcliError, InputError
from depthcli.evaluation.benchmarks import Benchmark, Entry, Submission, benchmark
from depthcli.evaluation.protocols import has_kitti_codes, load
from depthcli.io.formats.disparity import read_disparity
from depthcli.io.formats.files import atomic_path, collected_warnings, remove_temporaries
from depthcli.io.formats.images import image_size
from depthcli.run.records import read_report
from depthcli.show.table import to_json

_MAX_NAMED = 12  # scenes to name in one message, to keep it within a few lines


def export(
    printing: Printing,
    run: Annotated[Path, Argument(metavar="RUN", help="Run folder, or folder with maps of another program.")],
    for_: Annotated[str, Option("--for", metavar="BENCHMARK", help="middlebury-v3, kitti-2012, kitti-2015 or eth3d.")],
    method: Annotated[str, Option(metavar="NAME", help="Name of the method at the benchmark.")],
    output: Annotated[
        Path, Option("--output", "-o", metavar="FILE.zip", help="The archive to write.", callback=local_output)
    ],
    split: Annotated[str | None, Option(metavar="SPLIT", help="Only the training or only the test scenes.")] = None,
    sparse: Annotated[bool, Option("--sparse", help="Submit maps with holes as sparse maps (Middlebury).")] = False,
    seconds: Annotated[
        float | None, Option(metavar="S", min=0.0, help="Run time per scene, if the run has no report.")
    ] = None,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace the archive.")] = False,
) -> int:
    """Check all maps, write them, and return the exit code. Raise ConfigError with one line per problem."""
    reporter, bench = printing.reporter, benchmark(for_)
    if os.path.exists(output) and not overwrite:
        raise ConfigError(f"{output}: is there already; choose another --output, or --overwrite it")
    if split is not None and split not in bench.scenes:
        raise ConfigError(f"--split: must be {' or '.join(bench.scenes)} (got {split!r})")
    splits = [split] if split else list(bench.scenes)
    entries, problems = _find_maps(run, bench, splits, seconds)

    def read(file: Path) -> NDArray[np.float32]:
        return read_disparity(file, asks=not has_kitti_codes(bench.protocol))

    sizes: dict[str, tuple[int, int]] = {}
    submission = Submission(method, sparse, sizes)
    with reporter.counting(len(entries), 0, "check"):
        for entry in entries:
            try:
                with collected_warnings() as lines:
                    disparity = read(entry.file)
                problems += [f"{entry.scene}: {reason}" for reason in bench.problems(entry, disparity, submission)]
                sizes[entry.scene] = (disparity.shape[1], disparity.shape[0])
            except DepthcliError as error:
                problems.append(f"{entry.scene}: {error}")
            for line in lines:
                reporter.info(f"warning: {line}")
            reporter.step()
    problems = bench.together(submission) + problems
    if problems:
        head = f"{run}: not as {for_} takes it, nothing written:"
        raise ConfigError("\n".join([head, *(f"  {line}" for line in problems)]))
    if unknown := [entry.scene for entry in entries if entry.size is None]:
        reporter.info(f"sizes not checked, as the images are not known: {_named(unknown)}")
    remove_temporaries(output.parent, output.name)
    names = _write_archive(output, (bench.files(e, read(e.file), submission) for e in entries))
    counts = {name: sum(entry.split == name for entry in entries) for name in splits}
    reporter.info(f"{output}: {len(names)} files, {', '.join(f'{n} {name}' for name, n in counts.items() if n)} scenes")
    if printing.json:
        reporter.data(to_json({"benchmark": for_, "method": method, "file": str(output), "files": names}))
    return 0


def _find_maps(
    run: Path, bench: Benchmark, splits: Sequence[str], seconds: float | None
) -> tuple[list[Entry], list[str]]:
    """Return the maps of the benchmark's scenes, and all problems; a split with any map must be complete."""
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
                measured = sum(row.get("seconds", {}).values()) if seconds is None else seconds
                image = Path(row["source"]) if row.get("source") else None
                size = (row["width"], row["height"]) if row.get("width") else None
                if image is not None and os.path.isfile(image):
                    with contextlib.suppress(InputError):
                        size = image_size(image)[::-1]
                entries.append(Entry(scene, split, path, measured or math.nan, image, size))
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


def _write_archive(target: Path, maps: Iterable[dict[str, bytes]]) -> list[str]:
    """Write the files of all maps without times or owners, so that equal maps give equal bytes."""
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
