"""Fusion: several similarity measures into one cost volume, weighted by confidence and consensus (chapter 6)."""

from __future__ import annotations

from depthcli.methods.fusion.pipeline import Consensus, Fusion, Measure

__all__ = ["Consensus", "Fusion", "Measure"]
