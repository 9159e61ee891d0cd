"""Put compiled kernels into a wheel: hatchling calls this for every wheel, ``build_wheel`` says where they are."""

from __future__ import annotations

import os
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelsHook(BuildHookInterface):
    """Adds the folder that ``DEPTHCLI_KERNELS`` names and sets the tag ``DEPTHCLI_WHEEL_TAG``; else does nothing."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Change what goes into the wheel."""
        folder = os.environ.get("DEPTHCLI_KERNELS")
        if folder and version != "editable":
            build_data["force_include"][folder] = "depthcli/kernels/compiled"
            build_data["tag"] = os.environ["DEPTHCLI_WHEEL_TAG"]
            build_data["pure_python"] = False
