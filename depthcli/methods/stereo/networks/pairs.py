"""Networks that map a pair to a disparity map: which input is which, and how the output is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.networks.images import ImageInput, padded, planes, resized, samples
from depthcli.methods.stereo.networks.profiles import Profile
from depthcli.methods.stereo.networks.runtime import Port, Session

View = Literal["left", "right"]


@dataclass(frozen=True)
class Feed:
    """What an input gets: one view, or both, one after the other along the channels; at full or at half size."""

    target: ImageInput
    views: tuple[View, ...]
    half: bool = False

    @property
    def channels(self) -> int:
        """Channels of a view."""
        return 3 if self.target.channels is None else self.target.channels // len(self.views)


@dataclass(frozen=True)
class PairNetwork:
    """A network that maps a pair to the left view's disparities.

    Attributes
    ----------
    conventions : what it takes and gives
    size : (H, W) of the images that it takes; None: any, with sides that are a multiple of ``conventions.multiple``
    """

    session: Session
    conventions: Profile
    feeds: tuple[Feed, ...]
    size: tuple[int, int] | None
    scalars: dict[str, NDArray[Any]]

    @classmethod
    def of(
        cls, session: Session, conventions: Profile, size: tuple[int, int] | None, iterations: int | None
    ) -> PairNetwork:
        """Find out from names and shapes what the inputs of a network take.

        Parameters
        ----------
        size : (H, W) of the images that the network gets; None: that of its input, if it has one
        iterations : for a network with an integer input that says how many; None where it has none

        Raises
        ------
        InputError
            The inputs are of no known kind, or do not fit ``size`` or ``iterations``.
        """
        counts = [port for port in session.inputs if port.dtype in (np.int32, np.int64) and len(port.shape) < 2]
        feeds = _feeds([port for port in session.inputs if port not in counts], session.model)
        if bool(counts) != (iterations is not None) or len(counts) > 1:
            what = "needs a number of iterations" if counts else "has a fixed number of iterations"
            raise InputError(f"{session.model}: the network {what}; see iterations")
        scalars = {port.name: np.full([1] * len(port.shape), iterations, port.dtype) for port in counts}
        own = next(feed for feed in feeds if not feed.half).target.size
        fixed = (own[0], own[1]) if own[0] is not None and own[1] is not None else None
        if fixed is not None and size not in (None, fixed):
            raise InputError(f"{session.model}: the network takes images of {fixed[1]} x {fixed[0]}; leave size out")
        return cls(session, conventions, feeds, fixed or size, scalars)

    def __call__(self, pair: StereoPair) -> NDArray[np.float32]:
        """Return (H, W) float32 disparities of the left view, pixels, whatever range and sign they turn out to have.

        Raises
        ------
        InputError
            The network fails, or gives no map of the size of its input.
        """
        views = {}
        for channels in {feed.channels for feed in self.feeds}:
            for view, image in zip(("left", "right"), samples(pair, channels), strict=True):
                if self.size is None:
                    views[view, channels] = padded(image, self.conventions.multiple)
                else:
                    views[view, channels] = resized(image, self.size)
        first = next(iter(views.values()))
        size = (first.shape[0], first.shape[1])
        values = {feed.target.port.name: self._array(feed, views, size) for feed in self.feeds}
        disparity = _map_in(self.session.run(values | self.scalars), size, self.session.model)
        height, width = pair.shape
        if self.size is None:
            disparity = disparity[:height, :width]
        elif size != pair.shape:
            disparity = resized(disparity, pair.shape) * np.float32(width / size[1])
        return -disparity if self.conventions.sign == "negative" else disparity

    def _array(
        self, feed: Feed, views: dict[tuple[str, int], NDArray[np.float32]], size: tuple[int, int]
    ) -> NDArray[Any]:
        images = [views[view, feed.channels] for view in feed.views]
        if feed.half:
            own = feed.target.size
            images = [resized(image, (own[0] or size[0] // 2, own[1] or size[1] // 2)) for image in images]
        normal = [planes(image, self.conventions.normalization, self.conventions.color_order) for image in images]
        return feed.target.array(np.concatenate(normal))


def _feeds(ports: list[Port], model: str) -> tuple[Feed, ...]:
    targets = [ImageInput.of(port, model) for port in ports]
    if len(targets) == 1 and targets[0].channels in (2, 6):
        return (Feed(targets[0], ("left", "right")),)
    if len(targets) == 2 and all(target.channels in (None, 1, 3) for target in targets):
        return _two(targets, half=False)
    if len(targets) == 4 and all(target.channels in (None, 1, 3) for target in targets):
        order = sorted(range(4), key=lambda k: (_area(targets[k]), "init" not in targets[k].port.name.lower(), k))
        return _two([targets[k] for k in order[:2]], half=True) + _two([targets[k] for k in order[2:]], half=False)
    shown = ", ".join(f"{port.name} {port.shape}".replace("None", "?") for port in ports)
    # CREStereo is also exported in two files, of which the second takes two images and the flow of the first.
    part = "; is it one part of a network in two files? take one file with four images" if len(targets) == 3 else ""
    raise InputError(
        f"{model}: want one input of 2 or 6 channels, two images, or four with two at half size; it has {shown}{part}"
    )


def _two(targets: list[ImageInput], half: bool) -> tuple[Feed, ...]:
    # In the order of the network, unless their names say that the right one comes first.
    first, second = targets
    if "right" in first.port.name.lower() and "left" in second.port.name.lower():
        first, second = second, first
    return Feed(first, ("left",), half), Feed(second, ("right",), half)


def _area(target: ImageInput) -> int:
    return (target.size[0] or 0) * (target.size[1] or 0)


def _map_in(outputs: dict[str, NDArray[Any]], size: tuple[int, int], model: str) -> NDArray[np.float32]:
    """Return the output that is a map of that size: one whose name has "disp", else the last one."""
    maps = {name: found for name, array in outputs.items() if (found := _plane(array, size)) is not None}
    if not maps:
        shown = ", ".join(f"{name} {array.shape}" for name, array in outputs.items())
        raise InputError(f"{model}: no output is a map of {size[1]} x {size[0]} pixels; there are {shown}")
    named = [name for name in maps if "disp" in name.lower()]
    return np.ascontiguousarray(maps[(named or list(maps))[-1]], np.float32)


def _plane(array: NDArray[Any], size: tuple[int, int]) -> NDArray[Any] | None:
    # The first channel: a second one is the disparity along y.
    if array.ndim == 4 and array.shape[0] == 1:
        array = array[0]
    if array.ndim == 3:
        array = array[0] if array.shape[1:] == size and array.shape[0] <= 2 else array[..., 0]
    return array if array.shape == size else None
