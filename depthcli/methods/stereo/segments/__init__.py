"""Segment-based stereo (thesis chapter 2): its steps, each with its part of the config. ``steps`` has the data flow."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Step(BaseModel):
    """Base of the steps: a callable with its parameters."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
