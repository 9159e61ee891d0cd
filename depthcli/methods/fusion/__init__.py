"""Fusion: several similarity measures into one cost volume, weighted by confidence and consensus (chapter 6)."""

from __future__ import annotations

from depthcli.methods.fusion.measures import Measure
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.fusion.votes import Consensus

__all__ = ["Consensus", "Fusion", "Measure"]
