"""Choice by graph cuts: the mix of the proposals of least energy. Needs no training, takes any proposals."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.methods.fusion.choice import Chooser, Chosen, Proposals
from depthcli.methods.fusion.surfaces import Smoothness, Surface, contradictions, disagreements, matching_costs

_MIN_DIFFERENCE = 0.25  # maps that are closer than this count as the same, pixels; chosen by hand


class Energy(Chooser):
    """The mix of the maps of least energy: by costs, by the other maps, by the right view, and smooth.

    The energy of a map is the sum over its pixels of ``cost_weight`` times the matching cost along it,
    ``agreement_weight`` times the weighted share of the other maps that disagree, ``visibility_weight`` times how far
    the right view contradicts it, each averaged over pixels of similar color, and of a smoothness term in which slopes
    cost nothing. From the map of the largest weight on, every map is offered in turn, their median first, and the
    best mix of it with the current one is kept (fusion moves: Lempitsky, Rother, Roth and Blake, PAMI 2010).
    """

    cost_weight: float = Field(2.0, ge=0, le=1e3, description="weight of the fused costs, in units of one measure")
    cost_truncation: float = Field(
        0.7, gt=0, le=16, description="largest cost of a pixel: what the right camera sees differently must not decide"
    )
    agreement_weight: float = Field(3.0, ge=0, le=1e3, description="weight of the other maps' disagreement")
    visibility_weight: float = Field(2.0, ge=0, le=1e3, description="weight of the right view's contradiction")
    hidden: float = Field(0.5, ge=0, le=1, description="contradiction counted where a map is hidden in the right view")
    smoothness: float = Field(4.0, ge=0, le=1e3, description="cost of a pixel of misfit between neighbors")
    truncation: float = Field(2.0, gt=0, le=1e3, description="largest misfit that counts, pixels")
    color_scale: float = Field(
        10.0, gt=0, le=1e4, description="color difference that makes misfits cheaper by 1/e, grey levels"
    )
    floor: float = Field(0.1, ge=0, le=1, description="smallest factor by which misfits become cheaper")

    def __call__(self, proposals: Proposals) -> Chosen:
        image = proposals.pair.color8[0]
        maps, weights = proposals.values, proposals.weights
        far, near = proposals.far, proposals.near
        costs = np.float32(self.cost_weight) * matching_costs(maps, proposals.volume, self.cost_truncation, far)
        costs += np.float32(self.agreement_weight) * disagreements(maps, weights, near)
        costs += np.float32(self.visibility_weight) * contradictions(maps, proposals.right, self.hidden, near)
        smoothness = Smoothness.of(image, self.smoothness, self.color_scale, self.floor, self.truncation)
        start = int(weights.argmax())
        current = Surface(maps[start], slopes(maps[start], image), costs[start])
        for k, (values, cost) in enumerate(zip(maps, costs, strict=True)):
            if k == start:
                continue
            offered = Surface(values, slopes(values, image), cost)
            switched = smoothness.move(current, offered, _MIN_DIFFERENCE)
            if switched is not None:
                current = current.mixed(offered, switched)
        return Chosen(current.values)

    def bytes_a_pixel(self, count: int) -> int:
        return 12 * count + 1000
