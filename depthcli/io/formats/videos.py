"""Read single frames of video files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.files import open_regular, shown

VIDEO_SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")
"""Endings of video files."""

_RATES = (0.01, 2000.0)  # plausible frames per second; decoders report others if a file has none

_open: dict[Path, tuple[cv2.VideoCapture, int]] = {}
"""Path -> open video and number of its next frame; frames are mostly read in order."""


def _video(path: Path) -> cv2.VideoCapture:
    # FFmpeg only: another backend takes numbered names for image sequences and would decode them unchecked.
    return cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)


def frames_and_rate(path: Path) -> tuple[int, float]:
    """Return the number of frames in a video's header and the frames per second, 0 if unknown.

    Raise InputError if the video cannot be decoded.
    """
    with open_regular(path):
        video = _video(path)
    count = int(video.get(cv2.CAP_PROP_FRAME_COUNT)) if video.isOpened() else 0
    rate = float(video.get(cv2.CAP_PROP_FPS)) if count else 0.0
    video.release()
    if count < 1:
        raise InputError(f"{shown(path)}: no video that can be decoded here")
    return count, rate if _RATES[0] <= rate <= _RATES[1] else 0.0


def read_frame(path: Path, number: int) -> NDArray[np.uint8]:
    """Return the frame ``number`` (from 0) of a video, (H, W, 3) uint8 RGB. Raise InputError on failure."""
    # Seeking is not exact in every format, so that decoding continues after the last frame that was read.
    video, following = _open.get(path, (None, 0))
    if video is None or number < following:
        video, following = _video(path), 0
    while following < number and video.grab():
        following += 1
    done, frame = video.read()
    if not done or following < number:
        _open.pop(path, None)
        raise InputError(f"{shown(path)}: ends before frame {number}, or is damaged there")
    _open[path] = (video, number + 1)
    return np.ascontiguousarray(frame[..., ::-1], np.uint8)
