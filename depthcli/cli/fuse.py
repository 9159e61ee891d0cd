"""``depthcli fuse``."""

from __future__ import annotations

from depthcli.cli._pairs import pair_command

fuse = pair_command(
    "fuse", "Match image pairs by several measures, each trusted where the pixels around agree with it."
)
