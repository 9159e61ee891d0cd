"""Root of the ``fuse`` command's config."""

from __future__ import annotations

from typing import ClassVar

from depthcli.core.method import RootConfig
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo.config import PairConfig


class FuseConfig(PairConfig, Fusion, RootConfig):
    """The fields of ``Fusion`` and of every config that matches pairs, side by side."""

    flattened: ClassVar[str] = ""
