"""Costs of boundaries between segments with different planes (thesis, eq. 2.12). One file per method."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.regions import RegionGraph
from depthcli.core.maps import Doubles
from depthcli.core.method import Method, method_of


class BoundaryCost(Method):
    """A cost of two neighboring segments that have different planes; ``energy.smoothness`` multiplies it."""

    @abstractmethod
    def __call__(self, graph: RegionGraph) -> NDArray[Any]:
        """Return the costs of the E edges of a graph of segments, (E,) floats, finite and not negative.

        ``graph.boundary`` has the lengths of the common boundaries, ``graph.means`` the mean colors of the segments,
        ``graph.edges`` the segments of each edge.
        """


class ColorBoundary(BoundaryCost):
    """A cost per pixel of the boundary that falls with the distance of the mean colors; see :meth:`falloff`."""

    color_scale: float = Field(150.0, gt=0, le=1e6, description="scale of color differences (thesis: sigma), levels")
    color: Literal["rgb", "grey"] = Field(
        "rgb", description="difference (thesis: tau): Euclidean, or between the means of red, green and blue"
    )

    def __call__(self, graph: RegionGraph) -> Doubles:
        squared = graph.distances
        if self.color == "grey":
            grey = graph.means.mean(axis=1)
            squared = np.square(grey[graph.edges[:, 0]] - grey[graph.edges[:, 1]])
        return np.asarray(graph.boundary * self.falloff(squared / self.color_scale**2), np.float64)

    @abstractmethod
    def falloff(self, squared: Doubles) -> Doubles:
        """Return the cost of a boundary per pixel, for squared color differences over the squared scale."""


Boundary = Annotated[BoundaryCost, *method_of("depthcli.methods.stereo.boundary")]
