"""Root of the ``fuse`` command's config."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from depthcli.fusion.pipeline import Fusion
from depthcli.stereo.config import MaxDisparity


class FuseConfig(Fusion):
    """The fields of fusion and the search range, side by side."""

    max_disparity: MaxDisparity = None
    run: dict[str, Any] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")
