"""A stereo network in an ONNX file."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.context import Clock, Context
from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Floats, Image8, Mask, Status
from depthcli.kernels.winners import left_right_difference
from depthcli.methods.stereo.networks import (
    ColorOrder,
    ImageInput,
    Network,
    Normalization,
    Session,
    normalized,
    padded,
    samples,
)
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.volume import StereoResult

ProfileName = Literal["hitnet", "crestereo", "raft-stereo", "igev", "foundation-stereo"]
Sign = Literal["positive", "negative"]


class Profile(NamedTuple):
    """Conventions of a network; fields of the config override them."""

    normalization: Normalization = "0-255"
    color_order: ColorOrder = "rgb"
    multiple: int = 32  # of the sides of images, if it takes more than one size
    sign: Sign = "positive"  # of its output for positive disparities


PROFILES: dict[ProfileName, Profile] = {
    # PINTO_model_zoo 142_HITNET, as stereodemo and ONNX-HITNET-Stereo-Depth-estimation run it: one input of 6
    # channels, left RGB and right RGB, or of 2 grey ones (the network trained for ETH3D), from 0 to 1; sizes are
    # fixed; output (1, H, W, 1), "reference_output_disparity".
    "hitnet": Profile(normalization="0-1"),
    # PINTO_model_zoo 284_CREStereo, as stereodemo and ONNX-CREStereo-Depth-Estimation run it: left and right, or
    # ("combined") both at half size before both at full size, RGB from 0 to 255; sizes are fixed; output (1, 2, H, W)
    # whose first channel is the disparity.
    "crestereo": Profile(),
    # Exports of princeton-vl/RAFT-Stereo in test mode: left and right, RGB from 0 to 255 (the graph itself normalizes
    # them); outputs: flow at a fourth of the size, then at full size, along x: minus the disparity.
    "raft-stereo": Profile(sign="negative"),
    # Exports of gangweiX/IGEV and IGEV-plusplus in test mode: left and right, or one input of 6 channels, RGB from 0 to
    # 255 (the graph itself normalizes them); output: the disparity at full size.
    "igev": Profile(),
    # scripts/make_onnx.py of NVlabs/FoundationStereo: "left" and "right", RGB from 0 to 255 (the graph itself
    # normalizes them by ImageNet's moments); sizes are fixed; output "disp".
    "foundation-stereo": Profile(),
}


_Side = Annotated[int, Field(ge=16, le=16384)]


class NetworkPipeline(Network, StereoPipeline):
    """A network that maps a rectified pair to the left view's disparities, run by onnxruntime.

    Inputs are identified by names and shapes: one with 6 or 2 channels (left, then right), two images, or four, two of
    which are the pair at half size. Channels are the first or the last axis. The output is the one of the input's size;
    if there are several, the last one, preferably with "disp" in its name. A profile sets the conventions of a
    published network; fields that are given override it.

    The network runs a second time on the pair swapped and mirrored, which gives the right view's map. A pixel where the
    two disagree is ``MISMATCH`` if the right view is matched to it, and otherwise ``OCCLUDED``. The network's value
    there is a guess from its surroundings: ``FILLED``. Confidence ``lrc`` is minus the difference.
    """

    uses_devices: ClassVar[bool] = False

    profile: ProfileName | None = Field(None, description="conventions of a published network; null: fields below")
    normalization: Normalization | None = Field(
        None, description="range of the values that the network takes; null: as in the profile, or 0-255"
    )
    color_order: ColorOrder | None = Field(None, description="order of channels; null: as in the profile, or rgb")
    multiple: int | None = Field(
        None, ge=1, le=1024, description="divisor of the images' sides, pixels; null: as in the profile, or 32"
    )
    size: tuple[_Side, _Side] | None = Field(
        None,
        description="width and height of its images, pixels; null: its fixed size, or the size of the pair",
    )
    sign: Sign | None = Field(None, description="sign of its output; null: as in the profile, or positive")
    iterations: int | None = Field(
        None, ge=1, le=1000, description="number of iterations, if the network has an input for it; null: it has none"
    )
    left_right_check: bool = Field(True, description="compare with the right view's map, which takes twice the time")
    tolerance: float = Field(1.0, ge=0, le=16384, description="largest left-right difference, pixels")
    fill: bool = Field(True, description="keep the network's values at pixels that fail the check")
    self_check: bool = Field(True, description="whether the network must find a known shift before a run")

    def check(self) -> None:
        self._plan()
        if self.self_check:
            _check_shifts(self, self.session)

    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None) -> StereoResult:
        """Match the whole pair; disparities beyond 0 .. ``max_disparity`` are out of range.

        Raise InputError if the network fails.
        """
        clock = Clock()
        clock.start("network")
        values = self.left_map(pair)
        if not self.left_right_check:
            disparity = _in_range(values, np.zeros(pair.shape, np.uint8), max_disparity)
            return StereoResult(disparity, seconds=clock.seconds)
        first, second = (cast(Image, np.ascontiguousarray(image[:, ::-1])) for image in (pair.right, pair.left))
        right = self.left_map(StereoPair(first, second, pair.bits))[:, ::-1]
        clock.start("left_right_check")
        difference, hit = _compared(values, right)
        failed = difference > self.tolerance
        status = np.where(hit, Status.MISMATCH, Status.OCCLUDED) | Status.FILLED
        disparity = _in_range(values, np.where(failed, status, 0).astype(np.uint8), max_disparity)
        if not self.fill:
            disparity.values[failed] = np.nan
            disparity.status[failed] &= ~np.uint8(Status.FILLED)
        return StereoResult(disparity, seconds=clock.seconds, confidence={"lrc": -difference})

    def tile_halo(self) -> int | None:
        return None

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the bytes of a network that has several layers of 64 channels at half size at a time."""
        return 1024 * shape[0] * shape[1] + (256 << 20)

    def left_map(self, pair: StereoPair) -> Floats:
        """Return (H, W) float32 disparities of the left view, pixels, not limited to any range."""
        given = {name: value for name in Profile._fields if (value := getattr(self, name)) is not None}
        conventions = (Profile() if self.profile is None else PROFILES[self.profile])._replace(**given)
        session = self.session
        feeds, fixed = self._plan()
        sides = [-(-side // conventions.multiple) * conventions.multiple for side in pair.shape]
        height, width = size = fixed or (sides[0], sides[1])

        def image(feed: _Feed, view: int) -> Floats:
            full = samples(pair, view, feed.channels)
            full = padded(full, conventions.multiple) if fixed is None else _resized(full, size)
            if feed.half:
                rows, columns = feed.target.size
                full = _resized(full, (rows or height // 2, columns or width // 2))
            return normalized(full, conventions.normalization, conventions.color_order)

        values = {name: np.full_like(one, self.iterations or 1) for name, one in session.counts.items()}
        for feed in feeds:
            values[feed.target.name] = feed.target.array(np.dstack([image(feed, view) for view in feed.views]))
        disparity = _disparity_of(session.run(values), size, self.model)
        if fixed is None:
            disparity = disparity[: pair.shape[0], : pair.shape[1]]
        elif size != pair.shape:
            disparity = _resized(disparity, pair.shape) * np.float32(pair.shape[1] / width)
        return -disparity if conventions.sign == "negative" else disparity

    def _plan(self) -> tuple[list[_Feed], tuple[int, int] | None]:
        """Return the views that the inputs get, and the (H, W) of images (None: any).

        Raise InputError if the views are not clear.
        """
        session = self.session
        feeds = _feeds(session)
        if bool(session.counts) != (self.iterations is not None) or len(session.counts) > 1:
            what = "needs a number of iterations" if session.counts else "has a fixed number of iterations"
            raise InputError(f"{self.model}: the network {what}; see iterations")
        size = None if self.size is None else (self.size[1], self.size[0])
        height, width = next(feed for feed in feeds if not feed.half).target.size
        if height is None or width is None:
            return feeds, size
        if size not in (None, (height, width)):
            raise InputError(f"{self.model}: the network takes images of {width} x {height}; leave size out")
        return feeds, (height, width)


def _compared(left: Floats, right: Floats) -> tuple[Floats, Mask]:
    """Return the difference of the maps at each pixel of the left one, and whether the right one is matched to it."""
    known, known_right = (np.nan_to_num(np.maximum(view, 0), nan=0, posinf=0) for view in (left, right))
    width, hit = left.shape[1], np.zeros(left.shape, np.uint8)
    columns = np.arange(width) + np.minimum(np.rint(known_right), width).astype(np.int64)
    y, x = np.nonzero(columns < width)
    hit[y, columns[y, x]] = 1
    return left_right_difference(known, known_right), np.asarray(cv2.dilate(hit, np.ones((1, 3), np.uint8))) > 0


def _in_range(values: Floats, status: Image8, max_disparity: int) -> DisparityMap:
    # A value up to half a pixel beyond an end becomes the end.
    status[(values < -0.5) | (values > max_disparity + 0.5)] = Status.OUT_OF_RANGE
    status[~np.isfinite(values)] = Status.NO_DATA
    valid = (status & np.uint8(Status.OUT_OF_RANGE | Status.NO_DATA)) == 0
    values = np.where(valid, np.clip(values, 0, max_disparity), np.float32(np.nan))
    return DisparityMap(values.astype(np.float32), status)


class _Feed(NamedTuple):
    # The views that an input gets: one, or both, one after the other along the channels; at full or at half size.

    target: ImageInput
    views: tuple[int, ...]  # 0: left, 1: right
    half: bool = False

    @property
    def channels(self) -> int:
        """Channels of a view."""
        return 3 if self.target.channels is None else self.target.channels // len(self.views)


def _feeds(session: Session) -> list[_Feed]:
    """Return the views that a network's inputs get.

    Raise InputError if the number of inputs and their channels do not determine the views.
    """
    images, channels = [*session.images], {image.channels for image in session.images}
    if len(images) == 1 and channels <= {2, 6}:
        return [_Feed(images[0], (0, 1))]
    if len(images) not in (2, 4) or not channels <= {None, 1, 3}:
        shown = ", ".join(f"{image.name} ({image.channels or '?'} channels)" for image in images)
        # CREStereo is also exported in two files, of which the second takes two images and the flow of the first.
        part = "; is it one part of a network in two files? take one file with four images" if len(images) == 3 else ""
        raise InputError(
            f"{session.model}: expected one input of 2 or 6 channels, two images, or four with two at half size; "
            f"it has {shown}{part}"
        )
    if len(images) == 4:  # the smaller ones, or the ones with "init" in their names, are at half size
        images = sorted(images, key=lambda i: ((i.size[0] or 0) * (i.size[1] or 0), "init" not in i.name.lower()))
    feeds = []
    for k in range(0, len(images), 2):
        first, second = images[k : k + 2]  # in the order of the network, unless their names reverse it
        if "right" in first.name.lower() and "left" in second.name.lower():
            first, second = second, first
        feeds += [_Feed(first, (0,), k + 2 < len(images)), _Feed(second, (1,), k + 2 < len(images))]
    return feeds


def _disparity_of(outputs: dict[str, NDArray[Any]], size: tuple[int, int], model: str) -> Floats:
    """Return the output that is the map, (H, W) of ``size``: the last one, preferably with "disp" in its name."""
    maps = {}
    for name, array in outputs.items():
        if array.ndim == 3:  # of two channels in front, the second one is the disparity along y
            array = array[0] if array.shape[1:] == size and len(array) <= 2 else array[..., 0]
        if array.shape == size:
            maps[name] = array
    if not maps:
        shown = ", ".join(f"{name} {array.shape}" for name, array in outputs.items())
        raise InputError(f"{model}: no output is a map of {size[1]} x {size[0]} pixels; there are {shown}")
    named = [name for name in maps if "disp" in name.lower()]
    return np.ascontiguousarray(maps[(named or list(maps))[-1]], np.float32)


def _resized(image: Floats, size: tuple[int, int]) -> Floats:
    """Return an (H, W) or (H, W, C) image with ``size`` rows and columns, averaged if it shrinks, otherwise linear."""
    if image.shape[:2] == size:
        return image
    shrinks = size[0] <= image.shape[0] and size[1] <= image.shape[1]
    result = cv2.resize(image, (size[1], size[0]), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return np.asarray(result.reshape(*size, *image.shape[2:]), np.float32)


_SHIFTS = (4, 12)  # pixels
_SIZE = (192, 320)  # if the network takes any size
_OCTAVES = (1, 2, 4, 8, 16)  # pixels, of the texture


@lru_cache(maxsize=4)  # exceptions are not cached, but end the run
def _check_shifts(method: NetworkPipeline, session: Session) -> None:
    """Raise InputError if the network does not find by how many pixels a textured plane is shifted."""
    found, size = [], method._plan()[1] or _SIZE
    for shift in _SHIFTS:
        disparity = method.left_map(_textured_plane(size, shift))
        rows, columns = (slice(side // 4, 3 * side // 4) for side in disparity.shape)
        inner = disparity[rows, columns]
        found.append(float(np.median(inner)) if np.isfinite(inner).all() else np.nan)

    def fits(factor: float) -> bool:
        return all(abs(value * factor - shift) <= 1 + 0.1 * shift for value, shift in zip(found, _SHIFTS, strict=True))

    if fits(1.0):
        return
    scale = found[1] / _SHIFTS[1]
    if fits(-1.0):
        problem = "the sign is wrong; set sign to the other one (positive, negative)"
    elif abs(scale) > 0.01 and fits(1 / scale):
        problem = f"the scale is wrong, {scale:.3g} for each pixel; expected pixels of the full size"
    else:
        problem = "it does not find them; see profile, normalization, color_order; self_check: false leaves this out"
    raise InputError(
        f"{method.model}: self-check: for pairs shifted by {_SHIFTS[0]} and {_SHIFTS[1]} pixels the network "
        f"gives {found[0]:.4g} and {found[1]:.4g}: {problem}"
    )


def _textured_plane(size: tuple[int, int], shift: int) -> StereoPair:
    # Noise of several scales: networks trained with photographs find little in noise of single pixels.
    rng = np.random.default_rng(0)
    height, width = size[0], size[1] + shift
    total = np.zeros((height, width, 3), np.float32)
    for octave in _OCTAVES:
        noise = rng.standard_normal((-(-height // octave), -(-width // octave), 3)).astype(np.float32)
        total += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    image = np.clip(total * np.float32(40 / len(_OCTAVES) ** 0.5) + np.float32(128), 0, 255).astype(np.uint8)
    left, right = (np.ascontiguousarray(part) for part in (image[:, : size[1]], image[:, shift:]))
    return StereoPair(left, right)
