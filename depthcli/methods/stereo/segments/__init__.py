"""Steps of the segment-based pipeline (thesis chapter 2), each a mapping of its config, and what they work on."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Step(BaseModel):
    """Parameters of one step; calling it runs it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
