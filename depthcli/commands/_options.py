"""Options that several commands have in common."""

from __future__ import annotations

from pathlib import Path

from depthcli.core.option import Option

INPUT = Option("input", Path, "Folder of scenes, or a CSV file of pairs.", "DIR", short="-i")
OUTPUT = Option("output", Path, "Folder to write into.", "DIR", short="-o", required=True)
LAYOUT = Option("layout", str, "Layout of the folder, where it is not recognized.", "NAME")
SCENES = Option("scenes", str, "Only scenes whose name matches; repeatable.", "GLOB", many=True)
NAME = Option("name", str, "Name of a single scene; default: its file's or folder's.", "NAME")
SELECT = (
    NAME,
    LAYOUT,
    SCENES,
    Option("set", str, "Override one key; repeatable.", "KEY=VALUE", many=True),
)
HOW = (
    Option("jobs", int, "Scenes at a time, each in a process.", "N", default=1, short="-j", least=1, most=512),
    Option("threads", int, "Threads of each process.", "N", least=1, most=1024),
    Option("max_memory", str, "Such as 2GiB. Default: all that is free.", "SIZE"),
    Option("overwrite", bool, "Replace what an earlier run with another config left.", default=False),
    Option("keep", str, "Files that stay of a scene, such as disp_left.pfm,status.png. Default: all.", "NAMES"),
    Option("shard", str, "Part I of N of the scenes, beside others in one folder. Default: Slurm's job array.", "I/N"),
    Option("scheduler", str, "Compute on the workers of a dask.distributed cluster.", "tcp://HOST:PORT"),
    Option("fail_fast", bool, "Stop at the first scene that fails.", default=False),
    Option("list_scenes", bool, "Print the names of the scenes; compute nothing.", default=False),
)
EVALUATE = Option("evaluate", bool, "Compare with the ground truth of the input folder.", default=False)
DRY_RUN = Option("dry_run", bool, "Only say what would be done: config, scenes, memory, what is done.", default=False)
HTML_FLAG = Option("html", bool, "As --evaluate, with evaluation/report.html to look at in a browser.", default=False)
