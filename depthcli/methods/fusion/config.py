"""Root of the ``fuse`` command's config."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from numpy.typing import NDArray

from depthcli.core.frames import StereoPair
from depthcli.core.method import RootConfig
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo.config import PairConfig
from depthcli.methods.stereo.stages import PairMatcher
from depthcli.methods.stereo.volume import StereoResult


class FuseConfig(PairConfig, Fusion, RootConfig):
    """The fields of ``Fusion`` and of every config that matches pairs, side by side."""

    flattened: ClassVar[str] = ""


@dataclass(frozen=True)
class FusionWithVolumes(PairMatcher):
    """Fusion with cost volumes that were made elsewhere."""

    fusion: Fusion  # fuses the measures
    # returns file name -> (H, W, D) costs; called when a pair is matched
    read_volumes: Callable[[], Mapping[str, NDArray[Any]]]

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        """Read the volumes and match the whole pair over disparities 0 .. ``max_disparity`` inclusive."""
        return self.fusion(pair, max_disparity, self.read_volumes())

    def tile_halo(self) -> int | None:
        """Return None: the volumes are those of the whole pair."""
        return None

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the peak working memory for images of (H, W) ``shape``, bytes."""
        return self.fusion.peak_bytes(shape, max_disparity)
