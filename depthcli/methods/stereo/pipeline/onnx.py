"""A stereo network in an ONNX file: pair in, map out."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Annotated, ClassVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Clock
from depthcli.kernels.winners import left_right_difference
from depthcli.methods.stereo.networks import Network
from depthcli.methods.stereo.networks.images import ColorOrder, Normalization
from depthcli.methods.stereo.networks.pairs import PairNetwork
from depthcli.methods.stereo.networks.profiles import DEFAULT, PROFILES, ProfileName, Sign
from depthcli.methods.stereo.networks.runtime import Session
from depthcli.methods.stereo.networks.self_check import check_shifts
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.volume import StereoResult

_Side = Annotated[int, Field(ge=16, le=16384)]


class Onnx(Network, StereoPipeline):
    """A network that maps a rectified pair to the left view's disparities, run by onnxruntime.

    Inputs are found from names and shapes: one with 6 or 2 channels (left, then right), two images, or four, of which
    two are the pair at half its size; channels are the first or the last axis. The output is the one of the size of the
    input, with "disp" in its name if there are several. A profile sets the conventions of a published network; fields
    that are given go before it.

    The network runs a second time on the pair swapped and mirrored, which gives the right view's map. Pixels where the
    two disagree are ``OCCLUDED``, if nothing in the right view is matched to them, else ``MISMATCH``; confidence
    ``lrc`` is minus the difference. The network's value there is a guess from around: ``FILLED``.
    """

    uses_devices: ClassVar[bool] = False

    profile: ProfileName | None = Field(None, description="conventions of a published network; null: fields below")
    normalization: Normalization | None = Field(
        None, description="range of the values that the network takes; null: the profile's, else 0-255"
    )
    color_order: ColorOrder | None = Field(None, description="order of channels; null: the profile's, else rgb")
    multiple: int | None = Field(
        None, ge=1, le=1024, description="what sides must be a multiple of, pixels; null: the profile's, else 32"
    )
    size: tuple[_Side, _Side] | None = Field(
        None, description="width and height of the images that it gets, pixels; null: its own, or that of the pair"
    )
    sign: Sign | None = Field(None, description="sign of its output; null: the profile's, else positive")
    iterations: int | None = Field(
        None, ge=1, le=1000, description="for networks with an input for their number; null: it has none"
    )
    left_right_check: bool = Field(True, description="compare with the right view's map, which takes twice the time")
    tolerance: float = Field(1.0, ge=0, le=16384, description="largest left-right difference, pixels")
    fill: bool = Field(True, description="keep the network's values where the check fails")
    self_check: bool = Field(True, description="whether the network must find a known shift before a run")

    def check(self) -> None:
        network = self._network()
        if self.self_check:
            _self_check(self, self.session, network.size)

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        """Match the whole pair; disparities beyond 0 .. ``max_disparity`` are out of range.

        Raises
        ------
        InputError
            The network cannot be used, or fails.
        """
        clock = Clock()
        clock.start("network")
        network = self._network()
        values = network(pair)
        if not self.left_right_check:
            return StereoResult(_in_range(values, np.zeros(pair.shape, np.uint8), max_disparity), seconds=clock.seconds)
        right = network(_mirrored(pair))[:, ::-1]
        clock.start("left_right_check")
        known, known_right = (np.nan_to_num(np.maximum(view, 0), nan=0, posinf=0) for view in (values, right))
        difference = left_right_difference(known, known_right)
        failed = difference > self.tolerance
        status = np.where(failed, np.where(_is_hit(known_right), Status.MISMATCH, Status.OCCLUDED), 0).astype(np.uint8)
        status[failed] |= np.uint8(Status.FILLED)
        disparity = _in_range(values, status, max_disparity)
        if not self.fill:
            disparity = DisparityMap(
                np.where(failed, np.float32(np.nan), disparity.values), disparity.status & ~np.uint8(Status.FILLED)
            )
        return StereoResult(disparity, seconds=clock.seconds, confidence={"lrc": -difference})

    def tile_halo(self) -> int | None:
        return None

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the bytes of a network with 64 channels at half the size, several of which exist at a time."""
        return 1024 * shape[0] * shape[1] + (256 << 20)

    def _network(self) -> PairNetwork:
        base = DEFAULT if self.profile is None else PROFILES[self.profile]
        given = {name: getattr(self, name) for name in ("normalization", "color_order", "multiple", "sign")}
        conventions = replace(base, **{name: value for name, value in given.items() if value is not None})
        size = None if self.size is None else (self.size[1], self.size[0])
        return PairNetwork.of(self.session, conventions, size, self.iterations)


@lru_cache(maxsize=4)
def _self_check(method: Onnx, session: Session, size: tuple[int, int] | None) -> None:
    # Once a process, method and opened file: an exception is not kept, but ends the run.
    check_shifts(method._network(), size, session.model)


def _mirrored(pair: StereoPair) -> StereoPair:
    left, right = (cast(Image, np.ascontiguousarray(image[:, ::-1])) for image in (pair.right, pair.left))
    return StereoPair(left, right, pair.bits)


def _in_range(values: NDArray[np.float32], status: NDArray[np.uint8], max_disparity: int) -> DisparityMap:
    # Half a pixel beyond an end is the end.
    status[(values < -0.5) | (values > max_disparity + 0.5)] = Status.OUT_OF_RANGE
    status[~np.isfinite(values)] = Status.NO_DATA
    valid = (status & np.uint8(Status.OUT_OF_RANGE | Status.NO_DATA)) == 0
    values = np.where(valid, np.clip(values, 0, max_disparity), np.float32(np.nan))
    return DisparityMap(values.astype(np.float32), status)


def _is_hit(right: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (H, W) bool: a pixel of the right view, or one beside it, is matched to this pixel of the left view."""
    height, width = right.shape
    columns = np.arange(width) + np.minimum(np.rint(right), width).astype(np.int64)
    rows, inside = np.broadcast_to(np.arange(height)[:, None], columns.shape), columns < width
    hit = np.zeros(right.shape, np.uint8)
    hit[rows[inside], columns[inside]] = 1
    return np.asarray(cv2.dilate(hit, np.ones((1, 3), np.uint8)) != 0)
