"""Root of the ``fuse`` command's config."""

from __future__ import annotations

from typing import ClassVar

from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo.config import PairConfig


class FuseConfig(PairConfig, Fusion):
    """The fields of ``Fusion`` and of every config that matches pairs, side by side."""

    command: ClassVar[str] = "fuse"
    flattened: ClassVar[str] = ""
