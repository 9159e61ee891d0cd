"""``depthcli stereo``."""

from __future__ import annotations

from depthcli.cli._pairs import pair_command

stereo = pair_command("stereo", "Match image pairs: a disparity map, its status and a preview for every scene.")
