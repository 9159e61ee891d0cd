"""Frames of two videos that run together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.core.errors import ConfigError, InputError
from depthcli.data.formats.files import open_regular, shown
from depthcli.data.scenes.stereo import StereoScene

if TYPE_CHECKING:
    from depthcli.core.frames import StereoPair
    from depthcli.data.formats.images import Image

_open: dict[Path, tuple[Any, int]] = {}
"""Videos that this process reads, with the number of the frame that comes next: frames are asked for in order."""


@dataclass(frozen=True, kw_only=True)
class VideoScene(StereoScene):
    """The frame ``number`` (from 0) of two videos, ``left`` and ``right``."""

    number: int = 0

    def load_views(self) -> tuple[Image, Image]:
        """Both frames, (H, W, 3) uint8 RGB; InputError where a video ends before or cannot be decoded."""
        self.check()
        assert self.right is not None
        return _frame(self.left, self.number), _frame(self.right, self.number)

    def load(self) -> StereoPair:
        """Both frames; InputError where their sizes differ."""
        from depthcli.data.formats.images import pair_of

        return pair_of(*self.load_views(), (self.left, self.right or self.left))


def video_scenes(left: Path, right: Path) -> list[StereoScene]:
    """A pair for every frame that both videos say they have.

    Raises
    ------
    ConfigError
        A video cannot be opened, or has no frames.
    """
    counts = []
    for path in (left, right):
        import cv2

        try:
            with open_regular(path):
                pass
        except InputError as error:
            raise ConfigError(str(error)) from None
        video = cv2.VideoCapture(str(path))
        counts.append(int(video.get(cv2.CAP_PROP_FRAME_COUNT)) if video.isOpened() else 0)
        video.release()
        if counts[-1] < 1:
            raise ConfigError(f"{shown(path)}: no video that can be decoded here")
    digits = max(6, len(str(max(counts))))
    return [
        VideoScene(name=f"{number:0{digits}}", folder=left.parent, left=left, right=right, number=number)
        for number in range(min(counts))
    ]


def _frame(path: Path, number: int) -> Image:
    """Frame by frame from where this process was: seeking is not exact in every format."""
    import cv2
    import numpy as np

    video, following = _open.get(path, (None, 0))
    if video is None or number < following:
        video, following = cv2.VideoCapture(str(path)), 0
    while following < number and video.grab():
        following += 1
    done, frame = video.read()
    if not done or following < number:
        _open.pop(path, None)
        raise InputError(f"{shown(path)}: ends before frame {number}, or is damaged there")
    _open[path] = (video, number + 1)
    return np.ascontiguousarray(frame[..., ::-1], np.uint8)
