"""Options that several commands have in common."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.batch.command import Values
from depthcli.core.errors import ConfigError
from depthcli.core.option import Option

if TYPE_CHECKING:
    from depthcli.batch.task import RunOptions

CONFIG = Option("config", str, "YAML file, or the name of a preset.", "CONFIG", required=True)
INPUT = Option("input", Path, "Folder of scenes, or a CSV file of pairs.", "DIR", short="-i")
OUTPUT = Option("output", Path, "Folder to write into.", "DIR", short="-o", required=True)
LAYOUT = Option("layout", str, "Layout of the input folder. Default: recognized from its files.", "NAME")
SCENES = Option("scenes", str, "Use only the scenes whose name matches; repeatable.", "GLOB", repeatable=True)
NAME = Option("name", str, "Name of a single scene. Default: that of its file or folder.", "NAME")
SET = Option("set", str, "Override one key of the config; repeatable.", "KEY=VALUE", repeatable=True)
EVALUATE = Option("evaluate", bool, "Compare the results with the ground truth of the input folder.", default=False)
HTML_FLAG = Option("html", bool, "Like --evaluate, and write evaluation/report.html.", default=False)
DRY_RUN = Option("dry_run", bool, "Print config, scenes and memory needed; compute nothing.", default=False)
SELECT = (NAME, LAYOUT, SCENES, SET)
RUN = (
    Option("jobs", int, "Number of scenes computed at a time, each by a process.", "N", default=1, short="-j",
           min_value=1, max_value=512),
    Option("threads", int, "Threads of each process. Default: all cores, divided by --jobs.", "N",
           min_value=1, max_value=1024),
    Option("max_memory", str, "Memory that may be used, such as 2GiB. Default: all that is free.", "SIZE"),
    Option("overwrite", bool, "Replace the results of an earlier run with another config.", default=False),
    Option("keep", str, "Files to keep of each scene, such as disp_left.pfm,status.png. Default: all.", "NAMES"),
    Option("shard", str, "Compute part I of N; other processes fill the same folder. Default: from Slurm's job array.",
           "I/N"),
    Option("scheduler", str, "Compute on the workers of this dask.distributed cluster.", "tcp://HOST:PORT"),
    Option("fail_fast", bool, "Stop at the first scene that fails.", default=False),
    Option("list_scenes", bool, "Print the names of the scenes; compute nothing.", default=False),
)  # fmt: skip


def run_options(values: Values) -> RunOptions:
    """Return how a run is carried out; ConfigError for a wrong size or shard, or options that exclude each other."""
    from depthcli.batch.resources import parse_bytes
    from depthcli.batch.sharing import parse_shard
    from depthcli.batch.task import RunOptions

    memory = parse_bytes(values["max_memory"]) if values["max_memory"] else None
    shard = parse_shard(values["shard"], os.environ)
    if shard is not None and (values.get("evaluate") or values.get("html")):
        raise ConfigError("--evaluate needs all scenes: run depthcli evaluate when all shards are done")
    if values["scheduler"] is not None and values["jobs"] != 1:
        raise ConfigError("--jobs and --scheduler exclude each other: a cluster has as many workers as it has")
    return RunOptions(
        jobs=values["jobs"],
        threads=values["threads"],
        max_memory=memory,
        overwrite=values["overwrite"],
        shard=shard,
        fail_fast=values["fail_fast"],
        keep=tuple(name.strip() for name in (values["keep"] or "").split(",") if name.strip()),
        scheduler=values["scheduler"],
    )
