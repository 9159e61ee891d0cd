"""Groups of options that several commands share: which scenes, how they are computed, what is kept."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar

import typer
from typer import Option

from depthcli.commands._shared_options import (
    FailFlaggedOption,
    FlagOption,
    HtmlOption,
    InputOption,
    LayoutOption,
    MaxDisparityOption,
    Printing,
    ScenesOption,
    option,
    parse_bytes,
)
from depthcli.core.errors import ConfigError
from depthcli.run.batch import Execution, shard_of
from depthcli.run.flags import Condition, conditions_of

_URL = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)  # pathlib leaves one slash


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Which scenes a command works on; a group of a command adds the options that name the files of a single one."""

    single_files: ClassVar[str] = ""
    """The options that name the files of a single scene, for messages."""

    input: InputOption = None
    name: str | None = option(None, metavar="NAME", help="Name of a single scene. Default: from its file.")
    layout: LayoutOption = None
    scenes: ScenesOption = None

    @property
    def patterns(self) -> list[str]:
        """The shell patterns of ``--scenes``, or the one that every name matches."""
        return self.scenes or ["*"]


@dataclass(frozen=True, kw_only=True)
class PairOptions(SceneOptions):
    """Image pairs: a folder of them, or the files of one, or of several by patterns or videos."""

    single_files: ClassVar[str] = "--left FILE and --right FILE"

    left: Path | None = option(None, metavar="FILE", help="Left image, pattern, folder or video; replaces --input.")
    right: Path | None = option(None, metavar="FILE", help="Right image, likewise.")


@dataclass(frozen=True, kw_only=True)
class RangeOptions(PairOptions):
    """Image pairs with what else is known of them: calibration and search range, which override keys of the config."""

    calibration: Path | None = option(None, metavar="FILE", help="Calibration, for pairs that are not rectified.")
    unit: str | None = option(None, metavar="UNIT", help="Unit of an OpenCV calibration's translation: m, cm or mm.")
    max_disparity: MaxDisparityOption = None
    min_disparity: str | None = option(None, metavar="N", help="Smallest disparity searched, or auto. Default: 0.")


@dataclass(frozen=True, kw_only=True)
class CodingOptions:
    """How the maps of other runs are named and coded."""

    pattern: list[str] | None = option(
        None, metavar="PATTERN", help="Path of a map, '{scene}/a.tiff'. Of one run: NAME=..."
    )
    scale: list[str] | None = option(
        None, metavar="CODES", help="Codes per pixel of integer maps. Of one run: NAME=..."
    )
    invalid: list[str] | None = option(
        None, metavar="VALUE", help="Value of maps that means none, or nan. Of one run: NAME=..."
    )


@dataclass(frozen=True, kw_only=True)
class FrameOptions(SceneOptions):
    """Frames of color and depth: a folder of them, or the files of one."""

    single_files: ClassVar[str] = "--color FILE and --depth FILE"

    color: Path | None = option(None, metavar="FILE", help="Color image, instead of --input.")
    depth: Path | None = option(None, metavar="FILE", help="Depth map, registered to --color if given.")


def _local(output: Path | None) -> Path | None:
    if output is not None and _URL.match(str(output)) and not os.path.lexists(output.parts[0]):
        raise typer.BadParameter("results are written to this machine, not to URLs; give a folder")
    return output


@dataclass(frozen=True, kw_only=True)
class RunOptions(Printing):
    """How the scenes are computed, where the results go, and what is reported of them.

    ``evaluate`` and ``html`` become options of commands whose group declares them so, see :class:`ScoredRunOptions`.
    """

    output: Annotated[Path, Option("--output", "-o", metavar="DIR", help="Folder to write into.", callback=_local)]
    overwrite: bool = option(False, "--overwrite", help="Replace an earlier run that had another config.")
    keep: str | None = option(None, metavar="NAMES", help="Files kept, as disp_left.pfm,status.png. Default: all.")
    jobs: int = option(1, "--jobs", "-j", metavar="N", min=1, max=512, help="Scenes at a time, each in a process.")
    threads: int | None = option(
        None, metavar="N", min=1, max=1024, help="Threads of a process. Default: cores / --jobs."
    )
    max_memory: str | None = option(None, metavar="SIZE", help="Memory to use, such as 2GiB. Default: all free.")
    shard: str | None = option(None, metavar="I/N", help="Compute part I of N. Default: from Slurm.")
    scheduler: str | None = option(None, metavar="ADDRESS", help="tcp://HOST:PORT of a dask.distributed cluster.")
    fail_fast: bool = option(False, "--fail-fast", help="Stop at the first scene that fails.")
    list_scenes: bool = option(False, "--list-scenes", help="Print the names of the scenes; compute nothing.")
    dry_run: bool = option(False, "--dry-run", help="Print config, scenes and memory; compute nothing.")
    flag: FlagOption = None
    fail_flagged: FailFlaggedOption = False
    evaluate: bool = False
    html: bool = False

    def __post_init__(self) -> None:
        """Raise ConfigError where options are wrong or exclude each other, before any file is read."""
        if self.execution.shard is not None and (self.evaluate or self.html):
            raise ConfigError("--evaluate needs all scenes: run depthcli evaluate when all shards are done")
        if self.scheduler is not None and self.jobs != 1:
            raise ConfigError("--jobs and --scheduler exclude each other: a cluster has as many workers as it has")
        assert isinstance(self.conditions, list)

    @cached_property
    def conditions(self) -> list[Condition]:
        """The conditions of ``--flag``; ConfigError if one is wrong, or ``--fail-flagged`` has none."""
        return conditions_of(self.flag, self.fail_flagged)

    @cached_property
    def execution(self) -> Execution:
        """How the run is carried out; ConfigError for a wrong size or shard."""
        return Execution(
            jobs=self.jobs,
            threads=self.threads,
            max_memory=parse_bytes(self.max_memory) if self.max_memory else None,
            overwrite=self.overwrite,
            shard=shard_of(self.shard, os.environ),
            fail_fast=self.fail_fast,
            keep=tuple(name.strip() for name in (self.keep or "").split(",") if name.strip()),
            scheduler=self.scheduler,
        )


@dataclass(frozen=True, kw_only=True)
class ScoredRunOptions(RunOptions):
    """The options of a run whose results can be compared with ground truth of its input."""

    evaluate: bool = option(False, "--evaluate", help="Compare the results with the input's ground truth.")
    html: HtmlOption = False
