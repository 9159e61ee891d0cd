"""Small networks that tests make themselves: a block matcher and local features, as ONNX graphs."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

_END = np.iinfo(np.int64).max


class Graph:
    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any, dtype: Any) -> str:
        from onnx import numpy_helper

        self.constants.append(numpy_helper.from_array(np.array(value, dtype), f"k{len(self.constants)}"))
        return f"k{len(self.constants) - 1}"

    def add(self, kind: str, *inputs: str, **attributes: Any) -> str:
        from onnx import helper

        self.nodes.append(helper.make_node(kind, list(inputs), [f"n{len(self.nodes)}"], **attributes))
        return f"n{len(self.nodes) - 1}"

    def slice(self, array: str, start: int, end: int, axis: int) -> str:
        return self.add("Slice", array, *(self.constant([n], np.int64) for n in (start, end, axis)))

    def save(self, path: Path, inputs: dict[str, Sequence[Any]], output: str) -> Path:
        from onnx import TensorProto, helper, save

        ports = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT if shape else TensorProto.INT64, shape)
            for name, shape in inputs.items()
        ]
        outputs = [helper.make_tensor_value_info(output, TensorProto.FLOAT, None)]
        graph = helper.make_graph(self.nodes, "toy", ports, outputs, self.constants)
        save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), str(path))
        return path


def block_matcher(
    path: Path, form: str = "two", size: Any = ("H", "W"), factor: float = 1.0, disparities: int = 24, multiple: int = 1
) -> Path:
    """Write a network that takes the cheapest of ``disparities`` blocks of 9 x 9, and multiplies it by ``factor``.

    The form "six" or "grey" has one input of 6 or 2 channels, "last" two with channels last; "four" matches at half
    the size; "iterations" is right where 3 iterations are requested. Heights must be a multiple of ``multiple``.
    """
    graph = Graph()
    height, width = size
    image: tuple[Any, ...] = (1, 3, height, width)
    inputs: dict[str, Sequence[Any]]
    if form in ("six", "grey"):
        channels = 3 if form == "six" else 1
        inputs = {"images": (1, 2 * channels, height, width)}
        left, right = graph.slice("images", 0, channels, 1), graph.slice("images", channels, _END, 1)
    elif form == "last":
        inputs = {"left": (1, height, width, 3), "right": (1, height, width, 3)}
        left, right = (graph.add("Transpose", name, perm=[0, 3, 1, 2]) for name in inputs)
    elif form == "four":
        half: tuple[Any, ...] = (1, 3, height // 2, width // 2) if height != "H" else (1, 3, "h", "w")
        inputs = {"init_left": half, "init_right": half, "next_left": image, "next_right": image}
        left, right = "init_left", "init_right"
    else:
        inputs = {"right": image, "left": image} if form == "right-first" else {"left": image, "right": image}
        left, right = "left", "right"
    if multiple > 1:  # only then rows can be reshaped so
        shape = graph.constant([1, 3, -1, multiple], np.int64)
        rows = graph.add("Reshape", graph.slice(left, 0, 1, 3), shape)
        zero = graph.add("Mul", graph.add("ReduceMean", rows, keepdims=0), graph.constant(0, np.float32))
        left = graph.add("Add", left, zero)
    wide = graph.add("Pad", right, graph.constant([0, 0, 0, disparities - 1, 0, 0, 0, 0], np.int64), mode="edge")
    costs = []
    for d in range(disparities):
        moved = graph.slice(wide, disparities - 1 - d, -d if d else _END, 3)
        difference = graph.add("ReduceMean", graph.add("Abs", graph.add("Sub", left, moved)), axes=[1], keepdims=1)
        costs.append(graph.add("AveragePool", difference, kernel_shape=[9, 9], pads=[4, 4, 4, 4]))
    disparity = graph.add("ArgMin", graph.add("Concat", *costs, axis=1), axis=1, keepdims=1)
    disparity = graph.add("Cast", disparity, to=1)
    if form == "four":
        scales = graph.constant([1, 1, 2, 2], np.float32)
        disparity = graph.add("Resize", disparity, "", scales, mode="nearest")
        factor *= 2
    if form == "iterations":
        inputs["iters"] = ()
        disparity = graph.add("Mul", disparity, graph.add("Cast", "iters", to=1))
        factor /= 3
    disparity = graph.add("Mul", disparity, graph.constant(factor, np.float32))
    if form == "last":
        disparity = graph.add("Transpose", disparity, perm=[0, 2, 3, 1])
    return graph.save(path, inputs, disparity)


def local_features(path: Path, channels: int | None = 3, pads: int = 0, stride: int = 1, batch: int = 1) -> Path:
    """Write a network that gives the 3 x 3 window of every pixel; channels None: its input is (H, W)."""
    graph, image = Graph(), "image"
    if channels is None:
        image = graph.add("Unsqueeze", image, graph.constant([0, 1], np.int64))
    count = channels or 1
    kernels = graph.constant(np.eye(9 * count).reshape(9 * count, count, 3, 3), np.float32)
    output = graph.add("Conv", image, kernels, pads=[pads] * 4, strides=[stride] * 2)
    return graph.save(path, {"image": ("H", "W") if channels is None else (batch, channels, "H", "W")}, output)


def has_onnx() -> bool:
    """Return whether networks can be made and run."""
    return all(importlib.util.find_spec(name) is not None for name in ("onnx", "onnxruntime"))
