"""Which kernels presets call with which types of arguments: what ``depthcli warmup`` compiles before they are called.

The list is ``calls.json``, written by ``scripts/record_kernels`` from runs of every preset. It only saves time: a
kernel that is missing there is compiled at its first call, one too many is compiled for nothing.
"""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from depthcli.kernels.jit import CompileWatch, types

FILE = Path(__file__).with_name("calls.json")

TypeText: TypeAlias = str | list[Any]
"""A type of an argument: ``float32``, ``uint8 3d C``, ``uint8 3d C readonly``, ``[CLASS, TYPE, ...]`` of a tuple."""


class KernelCall(NamedTuple):
    """One kernel, called with one list of types.

    Attributes
    ----------
    module, kernel : where the kernel is defined, and its name there
    arguments : types of its arguments as text
    seconds : processor time that its compilation took where the list was recorded
    """

    module: str
    kernel: str
    arguments: tuple[TypeText, ...]
    seconds: float

    @property
    def key(self) -> str:
        """The call without its time."""
        return json.dumps([self.module, self.kernel, self.arguments])

    def prepare(self) -> tuple[int, float]:
        """Load the kernel from disk or compile it; return how many kernels that compiled, and the processor time.

        Raises
        ------
        AttributeError, ImportError, ValueError
            The kernel is no longer there: the list is of another version.
        """
        kernel = getattr(importlib.import_module(self.module), self.kernel)
        start = time.process_time()
        with CompileWatch() as watch:
            kernel.compile(tuple(parse_type(text) for text in self.arguments))
        return watch.kernels, time.process_time() - start


def describe_type(kind: Any) -> TypeText:
    """Return the text of one of numba's types.

    Raises
    ------
    ValueError
        Kernels called from Python take arrays, numbers and tuples of them; this is another type.
    """
    if isinstance(kind, types.Array) and kind.aligned:
        return f"{kind.dtype} {kind.ndim}d {kind.layout}{'' if kind.mutable else ' readonly'}"
    if isinstance(kind, types.Number | types.Boolean | types.NoneType):
        return str(kind)
    if isinstance(kind, types.BaseTuple):
        name, content = getattr(kind, "instance_class", tuple), getattr(kind, "types", ())
        return [f"{name.__module__}:{name.__qualname__}", *(describe_type(each) for each in content)]
    raise ValueError(f"no text for the type {kind}")


def parse_type(text: TypeText) -> Any:
    """Return the type that :func:`describe_type` gave this text.

    Raises
    ------
    ValueError, AttributeError, ImportError
        There is no such type.
    """
    if isinstance(text, list):
        module, _, name = str(text[0]).partition(":")
        content = [parse_type(each) for each in text[1:]]
        if name == "tuple":
            return types.Tuple(content)
        named = getattr(importlib.import_module(module), name)
        return types.NamedUniTuple(content[0], len(content), named) if len(set(content)) == 1 else types.NamedTuple(
            content, named
        )  # fmt: skip
    name, *array = text.split()
    kind = getattr(types, {"bool": "boolean"}.get(name, name))
    if not array:
        return kind
    layout: Any = array[1]
    return types.Array(kind, int(array[0].removesuffix("d")), layout, readonly="readonly" in array)


@cache
def _document() -> Mapping[str, Any]:
    document: Mapping[str, Any] = json.loads(FILE.read_text("utf-8"))
    return document


def recorded_presets() -> list[str]:
    """Return the presets whose calls are known, as ``command/name``, and the commands that have no presets."""
    return sorted(_document()["presets"])


def recorded_calls(presets: Iterable[str]) -> list[KernelCall]:
    """Return the calls that any of these presets (``command/name``) makes, the longest compilation first."""
    numbers = {number for preset in presets for number in _document()["presets"].get(preset, ())}
    calls = [KernelCall(m, k, tuple(a), s) for m, k, a, s in (_document()["calls"][number] for number in numbers)]
    return sorted(calls, key=lambda call: (-call.seconds, call.key))


def missing_calls(preset: str) -> list[KernelCall]:
    """Return the calls of a preset (``command/name``) whose kernels no folder holds: they have to be compiled."""
    missing = []
    for call in recorded_calls([preset]):
        try:
            kernel = getattr(importlib.import_module(call.module), call.kernel)
            found = kernel._cache.holds(tuple(parse_type(text) for text in call.arguments), kernel.targetctx)
        except (AttributeError, ImportError, ValueError):  # the list is of another version, or there is no folder
            found = False
        if not found:
            missing.append(call)
    return missing


def write_calls(calls: Iterable[KernelCall], presets: Mapping[str, Iterable[KernelCall]]) -> None:
    """Write the list: one line for each call, in the order of their names, and one for each preset."""
    ordered = sorted(calls, key=lambda call: call.key)
    numbers = {call.key: number for number, call in enumerate(ordered)}
    lines = [json.dumps(call) for call in ordered]
    uses = [f"{json.dumps(name)}: {sorted(numbers[c.key] for c in used)}" for name, used in sorted(presets.items())]
    text = '{{"calls": [\n{}\n],\n"presets": {{\n{}\n}}}}\n'
    FILE.write_text(text.format(",\n".join(lines), ",\n".join(uses)), "utf-8")
