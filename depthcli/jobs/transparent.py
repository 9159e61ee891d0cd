"""Depth of transparent objects: a sensor that sees through them, and sparse depth from elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from depthcli.core.errors import InputError
from depthcli.io.items import Item
from depthcli.io.items.rgbd import RgbdItem
from depthcli.jobs._batch import ConfigCommand

if TYPE_CHECKING:
    from pydantic import BaseModel

    from depthcli.batch.runner import Outcome
    from depthcli.batch.tables import Column


class TransparentCommand(ConfigCommand):
    """Any pipeline of ``transparent/pipeline/``."""

    kinds: ClassVar[tuple[type[Item], ...]] = (RgbdItem,)

    def config_model(self) -> type[BaseModel]:
        """A pipeline and the scale of the depth files."""
        from depthcli.transparent.config import TransparentConfig

        return TransparentConfig

    def files(self, config: Any, item: RgbdItem) -> dict[str, Path]:
        """The frame's files and the sparse depth's."""
        sparse = {"sparse": item.sparse, "sparse_confidence": item.sparse_confidence}
        return super().files(config, item) | {role: file for role, file in sparse.items() if file is not None}

    def settings(self, config: Any, item: RgbdItem) -> dict[str, str]:
        """What the layout says about the files."""
        return {"depth_scale": str(config.depth_scale or item.depth_scale)}

    def columns(self) -> tuple[Column, ...]:
        """Size, and the shares of pixels that were kept, filled and replaced."""
        from depthcli.batch.tables import SIZE, Column, percent

        return (SIZE, *(Column(name, percent(name)) for name in ("known", "sparse", "kept", "filled", "replaced")))

    def compute(self, config: Any, item: RgbdItem, folder: Path, memory: int) -> Outcome:
        """Dense depth of one frame.

        Raises
        ------
        InputError
            The files cannot be used, there is no sparse depth, or ``memory`` bytes do not suffice.
        """
        import numpy as np

        from depthcli.batch.runner import Outcome
        from depthcli.core.maps import DepthStatus
        from depthcli.core.result import Clock
        from depthcli.jobs._save import save_depth

        clock = Clock()
        if config.depth_scale is not None:
            item = replace(item, depth_scale=config.depth_scale)
        frame = item.load_sparse()
        _check_memory(config, frame.shape, memory)
        clock.stop("load")
        result = config.pipeline(frame)
        clock.stop("other")
        clock.seconds["other"] = max(clock.seconds["other"] - sum(result.seconds.values()), 0.0)
        status = result.depth.status
        facts = {
            "width": frame.shape[1],
            "height": frame.shape[0],
            "known": round(float(np.mean(np.isfinite(frame.depth))), 6),
            "sparse": round(float(np.mean(np.isfinite(frame.sparse))), 6),
            "kept": round(float(np.mean(status == DepthStatus.KEPT)), 6),
            "filled": round(float(np.mean(status == DepthStatus.GAP_FILLED)), 6),
            "replaced": round(float(np.mean(status == DepthStatus.CORRECTED)), 6),
            "density": round(result.depth.density, 6),
            **{name: float(value) for name, value in result.figures.items()},
        }
        save_depth(result, folder, item.depth_scale, 3 if item.rotated else 0)
        clock.stop("save")
        seconds = {"load": clock.seconds["load"], **result.seconds} | clock.seconds
        return Outcome(facts, seconds)


def _check_memory(config: Any, shape: tuple[int, int], memory: int) -> None:
    from depthcli.batch.resources import show_bytes

    need = config.pipeline.peak_bytes(shape)
    if need > memory:
        raise InputError(
            f"needs about {show_bytes(need)} of memory ({shape[1]} x {shape[0]} pixels), "
            f"{show_bytes(memory)} may be used; see --max-memory, --jobs"
        )


COMMAND = TransparentCommand()
