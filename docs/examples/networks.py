"""Two small networks: blocks.onnx compares blocks of 9 x 9 pixels, features.onnx gives differences to 24 neighbors."""

import numpy as np
from onnx import TensorProto, helper, numpy_helper, save

DISPARITIES = 33


class Graph:
    """Nodes and constants of a network, in the order in which they are added."""

    def __init__(self):
        self.nodes, self.constants = [], []

    def constant(self, value):
        self.constants.append(numpy_helper.from_array(np.array(value), f"k{len(self.constants)}"))
        return self.constants[-1].name

    def add(self, kind, *inputs, **attributes):
        self.nodes.append(helper.make_node(kind, inputs, [f"n{len(self.nodes)}"], **attributes))
        return self.nodes[-1].output[0]

    def write(self, file, inputs, output):
        ports = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, "H", "W"]) for name in inputs]
        result = helper.make_tensor_value_info(output, TensorProto.FLOAT, None)
        graph = helper.make_graph(self.nodes, "net", ports, [result], self.constants)
        save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), file)


net = Graph()
wide = net.add("Pad", "right", net.constant([0, 0, 0, DISPARITIES - 1, 0, 0, 0, 0]), mode="edge")
costs = []
for d in range(DISPARITIES):
    end = -d if d else np.iinfo(np.int64).max
    moved = net.add("Slice", wide, net.constant([DISPARITIES - 1 - d]), net.constant([end]), net.constant([3]))
    difference = net.add("ReduceMean", net.add("Abs", net.add("Sub", "left", moved)), axes=[1])
    costs.append(net.add("AveragePool", difference, kernel_shape=[9, 9], pads=[4, 4, 4, 4]))
disparity = net.add("ArgMin", net.add("Concat", *costs, axis=1), axis=1)
net.write("blocks.onnx", ["left", "right"], net.add("Cast", disparity, to=TensorProto.FLOAT))

net = Graph()
kernels = np.zeros((25, 3, 5, 5), np.float32)
for n in range(25):
    kernels[n, :, n // 5, n % 5] += 1 / 3
    kernels[n, :, 2, 2] -= 1 / 3
features = net.add("Conv", "image", net.constant(kernels[np.arange(25) != 12]), pads=[2, 2, 2, 2])
net.write("features.onnx", ["image"], features)
