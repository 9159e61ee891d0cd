"""Choice by a small network that has seen where maps like these are wrong."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.errors import ConfigError, InputError
from depthcli.data.formats.atomic import atomic_path
from depthcli.data.formats.files import open_regular
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.kernels.lanes import LANES, load, smaller, splat, store
from depthcli.methods.fusion.choice import Chooser, Chosen, Proposals
from depthcli.methods.fusion.choice._inputs import OWN, RELATIVE_PLANES, SHARED, Inputs, gather, input_names
from depthcli.methods.fusion.votes import LANES as MOST
from depthcli.methods.fusion.votes import NOTHING

FORMAT = "depthcli choice 1"
_LARGEST_INPUT = np.float32(4.0)  # standard deviations: what training has not seen must not decide
_SHIPPED = Path(__file__).resolve().parent / "_networks"
_LARGEST_FILE = 1 << 24  # bytes
_TILE = 4  # units of a layer that are summed at a time: their sums stay in registers


class Network(Chooser):
    """The proposal that a small network finds most likely to be right to a pixel.

    For every proposal of a pixel the network, the same one for all pixels, is told some forty figures: the costs
    along it, which others agree, what the right view says, its shape. Its answers become shares by a softmax over
    the proposals, are averaged over neighbors of similar color, and the largest share wins. Selecting by a
    learned judge what several scanline optimizations propose goes back to Schoenberger, Sinha and Pollefeys (ECCV
    2018); the probability of the winner is a confidence. `scripts/train_choice.py` trains networks for other proposals.
    """

    tells: ClassVar[tuple[str, ...]] = ("probability",)

    weights: str = Field("accurate", description="a network of the package, or a .json file that training wrote")

    def check(self, kinds: tuple[str, ...]) -> None:
        trained = read_weights(self.weights).kinds
        if trained != kinds:
            raise ValueError(
                f"network {self.weights!r} was trained for the maps {', '.join(trained)}; "
                f"here they are {', '.join(kinds)}: train one (scripts/train_choice.py) or choose by 'energy'"
            )

    def __call__(self, proposals: Proposals) -> Chosen:
        weights = read_weights(self.weights)
        count, height, width = proposals.values.shape
        answers = weights(Inputs.of(proposals)).reshape(count, height, width)
        shares = memory.empty((height, width, MOST), np.float32)
        _softmax(answers, shares)
        proposals.near.sum(shares)
        values = np.empty((height, width), np.float32)
        probability = np.empty((height, width), np.float32)
        _take(proposals.values, answers, shares, values, probability)
        return Chosen(values, probability)

    def bytes_a_pixel(self, count: int) -> int:
        return 4 * (count * (len(OWN) + 4) + len(SHARED) + 2 * MOST) + 100


@dataclass(frozen=True)
class Weights:
    """A network of two hidden layers of rectified units, and how its inputs are scaled.

    Attributes
    ----------
    kinds : the proposals it was trained for
    mean, scale : (F,) float32; an input x enters as ``(x - mean) scale``, at most 4 either way
    layers : weights (inputs, units) and offsets of the three layers; the offsets of the first are (N, units), one for
        every proposal. Units are multiples of 4, but for the single last one
    """

    kinds: tuple[str, ...]
    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]

    def __call__(self, inputs: Inputs) -> NDArray[np.float32]:
        """(N, P) float32: log odds of every proposal to be right."""
        out = np.empty(inputs.values.shape, np.float32)
        (w1, b1), (w2, b2), (w3, b3) = self.layers
        _answer(
            inputs.values, inputs.own, inputs.shared, RELATIVE_PLANES, self.mean, self.scale,
            _tiled(w1), b1, _tiled(w2), b2, w3.ravel(), b3, out,
        )  # fmt: skip
        return out


def _tiled(weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """(units / 4, inputs, 4): in the order in which the kernel reads them."""
    inputs, units = weights.shape
    return np.ascontiguousarray(weights.reshape(inputs, units // _TILE, _TILE).transpose(1, 0, 2))


@lru_cache(maxsize=8)
def read_weights(name: str) -> Weights:
    """A network of the package, or of a file.

    Raises
    ------
    ConfigError
        There is none, or it holds something else.
    """
    file = Path(name) if name.endswith(".json") else _SHIPPED / f"{name}.json"
    try:
        with open_regular(file) as opened:
            found = json.loads(opened.read(_LARGEST_FILE).decode())
    except (InputError, ValueError, RecursionError) as error:
        shipped = ", ".join(sorted(p.stem for p in _SHIPPED.glob("*.json")))
        raise ConfigError(f"network {name}: cannot be read ({error}); those of the package are: {shipped}") from None
    try:
        return _parse(found)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"network {name}: not a network of this version ({error})") from None


def _parse(found: dict[str, Any]) -> Weights:
    if found["format"] != FORMAT:
        raise ValueError(f"format {found['format']!r}, want {FORMAT!r}")
    kinds = tuple(str(kind) for kind in found["maps"])
    names = input_names(kinds)
    if tuple(found["inputs"]) != names:
        raise ValueError("it wants other inputs")
    mean, scale = (np.array(found[key], np.float32) for key in ("mean", "scale"))
    layers = tuple(
        (np.array(layer["weights"], np.float32), np.array(layer["offsets"], np.float32)) for layer in found["layers"]
    )
    first, second = (layers[k][0].shape[1] for k in (0, 1))
    wanted = [
        ((len(names), first), (len(kinds), first)), ((first, second), (second,)), ((second, 1), (1,)),
    ]  # fmt: skip
    shapes = [(w.shape, b.shape) for w, b in layers]
    if shapes != wanted or first % _TILE or second % _TILE or mean.shape != scale.shape or mean.shape != (len(names),):
        raise ValueError(f"layers of shapes {shapes}")
    if not all(np.isfinite(array).all() for array in (mean, scale, *(a for layer in layers for a in layer))):
        raise ValueError("weights that are no numbers")
    if not 2 <= len(kinds) <= MOST:
        raise ValueError(f"want 2 to {MOST} maps")
    return Weights(kinds, mean, scale, layers)


def write_weights(file: Path, weights: Weights, trained_on: list[str]) -> None:
    """Write what :func:`read_weights` reads: text, four digits a number."""

    def plain(array: NDArray[np.float32]) -> Any:
        return np.vectorize(lambda value: float(f"{value:.4g}"), otypes=[float])(array).tolist()

    content = {
        "format": FORMAT,
        "trained_on": trained_on,
        "maps": weights.kinds,
        "inputs": input_names(weights.kinds),
        "mean": plain(weights.mean),
        "scale": plain(weights.scale),
        "layers": [{"weights": plain(w), "offsets": plain(b)} for w, b in weights.layers],
    }
    text = json.dumps(content, separators=(",", ":"))
    with atomic_path(file) as temporary:
        temporary.write_text(text.replace("],[", "],\n[").replace(',"', ',\n"') + "\n", "utf-8")


@jit
def _positive(a: Any) -> Any:
    return splat(np.float32(0)) - smaller(splat(np.float32(0)) - a, splat(np.float32(0)))


@jit
def _layer(source: Any, inputs: int, weights: Any, offsets: Any, target: Any) -> None:
    """Rectified units of LANES pixels: flat ``source`` and ``target`` hold LANES values an input, a unit."""
    for tile in range(weights.shape[0]):
        w = weights[tile]
        a, b = splat(offsets[tile * _TILE]), splat(offsets[tile * _TILE + 1])
        c, d = splat(offsets[tile * _TILE + 2]), splat(offsets[tile * _TILE + 3])
        for i in range(inputs):
            x = load(source, i * LANES)
            a += splat(w[i, 0]) * x
            b += splat(w[i, 1]) * x
            c += splat(w[i, 2]) * x
            d += splat(w[i, 3]) * x
        store(target, (tile * _TILE) * LANES, _positive(a))
        store(target, (tile * _TILE + 1) * LANES, _positive(b))
        store(target, (tile * _TILE + 2) * LANES, _positive(c))
        store(target, (tile * _TILE + 3) * LANES, _positive(d))


@parallel_jit
def _answer(
    values: Any, own: Any, shared: Any, relative: Any, mean: Any, scale: Any,
    w1: Any, b1: Any, w2: Any, b2: Any, w3: Any, b3: Any, out: Any,
) -> None:  # fmt: skip
    count, pixels = values.shape
    size = mean.size
    groups = (pixels + LANES - 1) // LANES
    chunk = 64
    for task in prange((groups + chunk - 1) // chunk):
        block = np.zeros((size, LANES), np.float32)
        flat = block.reshape(size * LANES)
        hidden = np.empty(w1.shape[0] * _TILE * LANES, np.float32)
        second = np.empty(w2.shape[0] * _TILE * LANES, np.float32)
        last = np.empty(LANES, np.float32)
        for group in range(task * chunk, min(groups, (task + 1) * chunk)):
            first = group * LANES
            for n in range(count):
                gather(values, own, shared, relative, n, first, block)
                for i in range(size):
                    cells = block[i]
                    for lane in range(LANES):
                        z = (cells[lane] - mean[i]) * scale[i]
                        cells[lane] = min(max(z, -_LARGEST_INPUT), _LARGEST_INPUT)
                _layer(flat, size, w1, b1[n], hidden)
                _layer(hidden, w1.shape[0] * _TILE, w2, b2, second)
                total = splat(b3[0])
                for i in range(w3.size):
                    total += splat(w3[i]) * load(second, i * LANES)
                store(last, 0, total)
                for lane in range(min(LANES, pixels - first)):
                    out[n, first + lane] = last[lane]


@parallel_jit
def _softmax(answers: Any, shares: Any) -> None:
    count, height, width = answers.shape
    for y in prange(height):
        for x in range(width):
            largest = answers[0, y, x]
            for n in range(1, count):
                largest = max(largest, answers[n, y, x])
            cells = shares[y, x]
            cells[:] = NOTHING
            total = np.float32(0)
            for n in range(count):
                cells[n] = exp_minus(largest - answers[n, y, x])
                total += cells[n]
            for n in range(count):
                cells[n] = cells[n] / total + NOTHING


@parallel_jit
def _take(maps: Any, answers: Any, shares: Any, values: Any, probability: Any) -> None:
    count, height, width = maps.shape
    one = np.float32(1)
    for y in prange(height):
        for x in range(width):
            best = 0
            for n in range(1, count):
                if shares[y, x, n] > shares[y, x, best]:
                    best = n
            values[y, x] = maps[best, y, x]
            odds = answers[best, y, x]
            e = exp_minus(abs(odds))
            probability[y, x] = one / (one + e) if odds > 0 else e / (one + e)
