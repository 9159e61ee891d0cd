"""Refinement: what is done to a disparity map after it was selected. One file a step."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from depthcli.core.maps import DisparityMap
from depthcli.core.method import Method, method_of
from depthcli.stereo.volume import Evidence


class Refinement(Method):
    """One step of the refinement list."""

    @abstractmethod
    def __call__(self, disparity: DisparityMap, evidence: Evidence) -> DisparityMap:
        """A new map; the input is not modified."""


RefinementStep = Annotated[Refinement, *method_of("depthcli.stereo.refinement")]
