"""Match image pairs: a disparity map, its status and a preview for every scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from depthcli.io.items.stereo import StereoItem
from depthcli.jobs._pairs import PairCommand

if TYPE_CHECKING:
    from pydantic import BaseModel

    from depthcli.core.frames import StereoPair
    from depthcli.stereo.volume import StereoResult


class StereoCommand(PairCommand):
    """Any pipeline of ``stereo/pipeline/``."""

    def config_model(self) -> type[BaseModel]:
        """A pipeline and the search range."""
        from depthcli.stereo.config import StereoConfig

        return StereoConfig

    def match(self, config: Any, item: StereoItem, pair: StereoPair, top: int) -> StereoResult:
        """By the config's pipeline."""
        result: StereoResult = config.pipeline(pair, top)
        return result

    def peak_bytes(self, config: Any, shape: tuple[int, int], top: int) -> int:
        """By the config's pipeline."""
        need: int = config.pipeline.peak_bytes(shape, top)
        return need


COMMAND = StereoCommand()
