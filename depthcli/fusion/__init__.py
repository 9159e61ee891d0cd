"""Fusion: several similarity measures into one cost volume, weighted by confidence and consensus (chapter 6)."""

from __future__ import annotations

from depthcli.fusion.pipeline import Fusion, FusionError, Measure

__all__ = ["Fusion", "FusionError", "Measure"]
