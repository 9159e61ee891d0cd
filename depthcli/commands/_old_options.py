"""Options that several commands have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.option import Option

if TYPE_CHECKING:
    pass

CONFIG = Option("config", str, "YAML file, or the name of a preset.", "CONFIG", required=True)
INPUT = Option("input", Path, "Folder, archive or URL of scenes, or CSV of pairs.", "DIR", short="-i", group="Input")
OUTPUT = Option("output", Path, "Folder to write into.", "DIR", short="-o", required=True, group="Output")
LAYOUT = Option("layout", str, "Layout of the folder. Default: recognized.", "NAME", group="Input")
SCENES = Option("scenes", str, "Only scenes whose name matches; repeatable.", "GLOB", repeatable=True, group="Input")
NAME = Option("name", str, "Name of a single scene. Default: from its file.", "NAME", group="Input")
SET = Option("set", str, "Override one key of the config; repeatable.", "KEY=VALUE", repeatable=True)
EVALUATE = Option("evaluate", bool, "Compare the results with the input's ground truth.", default=False, group="Report")
HTML_FLAG = Option("html", bool, "Also write evaluation/report.html.", default=False, group="Report")
DRY_RUN = Option("dry_run", bool, "Print config, scenes and memory; compute nothing.", default=False, group="Run")
SELECT = (NAME, LAYOUT, SCENES, SET)
RUN = (
    Option("overwrite", bool, "Replace an earlier run that had another config.", default=False, group="Output"),
    Option("keep", str, "Files kept, as disp_left.pfm,status.png. Default: all.", "NAMES", group="Output"),
    Option("jobs", int, "Scenes at a time, each in a process.", "N", default=1, short="-j",
           min_value=1, max_value=512, group="Run"),
    Option("threads", int, "Threads of a process. Default: cores / --jobs.", "N",
           min_value=1, max_value=1024, group="Run"),
    Option("max_memory", str, "Memory to use, such as 2GiB. Default: all free.", "SIZE", group="Run"),
    Option("shard", str, "Compute part I of N. Default: from Slurm.", "I/N", group="Run"),
    Option("scheduler", str, "tcp://HOST:PORT of a dask.distributed cluster.", "ADDRESS", group="Run"),
    Option("fail_fast", bool, "Stop at the first scene that fails.", default=False, group="Run"),
    Option("list_scenes", bool, "Print the names of the scenes; compute nothing.", default=False, group="Run"),
)  # fmt: skip
