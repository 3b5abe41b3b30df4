"""Four policies that see pictures, as ONNX files with random weights, for `sortie-tools bench policy`.

    venv/bin/pip install numpy onnx
    venv/bin/python benches/pictures.py runs/pictures
    sortie-tools bench policy runs/pictures/*.onnx --python venv/bin/python

atari: 84x84x4, three convolutions and 3136-512-6 (Mnih et al. 2015, as CleanRL exports it).
depth: 58x87 depth picture, two convolutions with pools, proprioception and a GRU (after Cheng et al. 2023, extreme parkour).
act: 48x64x3, three convolutions, a transformer of 49 tokens and 20 queries (after Zhao et al. 2023, ACT).
twins: two pictures 84x84x3 with an encoder each, and a vector (ML-Agents' simple encoder).
"""

import sys
from pathlib import Path

import numpy
import onnx
from onnx import TensorProto, helper


class Graph:
    """Nodes one behind the other; weights are drawn so that numbers keep their size."""

    def __init__(self, seed):
        self.random = numpy.random.default_rng(seed)
        self.nodes, self.weights, self.inputs = [], [], []

    def input(self, name, *shape):
        self.inputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
        return name

    def constant(self, values, kind=numpy.float32):
        name = f"c{len(self.weights)}"
        self.weights.append(onnx.numpy_helper.from_array(numpy.asarray(values, kind), name))
        return name

    def node(self, kind, *inputs, **attributes):
        name = f"v{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def drawn(self, *shape, inputs):
        return self.constant(self.random.normal(size=shape) * (2 / inputs) ** 0.5)

    def convolution(self, x, outputs, channels, size, **attributes):
        weights = self.drawn(outputs, channels, size, size, inputs=channels * size * size)
        return self.node("Conv", x, weights, self.drawn(outputs, inputs=100), kernel_shape=[size] * 2, **attributes)

    def layer(self, x, inputs, outputs):
        weights = self.drawn(inputs, outputs, inputs=inputs)
        return self.node("Add", self.node("MatMul", x, weights), self.drawn(outputs, inputs=100))

    def reshape(self, x, *shape):
        return self.node("Reshape", x, self.constant(shape, numpy.int64))

    def save(self, path, outputs):
        results = []
        for name, value, shape in outputs:
            self.nodes.append(helper.make_node("Identity", [value], [name]))
            results.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
        graph = helper.make_graph(self.nodes, path.stem, self.inputs, results, self.weights)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        onnx.checker.check_model(model)
        onnx.save(model, path)


def atari(folder):
    g = Graph(1)
    x = g.input("observation", 1, 4, 84, 84)
    for outputs, channels, size, stride in [(32, 4, 8, 4), (64, 32, 4, 2), (64, 64, 3, 1)]:
        x = g.node("Relu", g.convolution(x, outputs, channels, size, strides=[stride] * 2))
    x = g.node("Relu", g.layer(g.node("Flatten", x), 3136, 512))
    g.save(folder / "atari.onnx", [("values", g.layer(x, 512, 6), [1, 6])])


def depth(folder):
    g = Graph(2)
    picture, body = g.input("depth", 1, 1, 58, 87), g.input("proprioception", 1, 53)
    state = g.input("h_in", 1, 1, 256)
    x = picture
    for outputs, channels, size in [(32, 1, 5), (64, 32, 3)]:
        x = g.convolution(x, outputs, channels, size)
        x = g.node("Elu", g.node("MaxPool", x, kernel_shape=[2, 2], strides=[2, 2]))
    x = g.node("Elu", g.layer(g.node("Flatten", x), 64 * 12 * 19, 128))
    x = g.node("Concat", g.layer(x, 128, 32), body, axis=1)
    x = g.reshape(x, 1, 1, 85)
    weights = [g.drawn(1, 768, size, inputs=2 * size) for size in (85, 256)]
    bias = g.drawn(1, 1536, inputs=100)
    g.nodes.append(helper.make_node("GRU", [x, *weights, bias, "", state], ["", "h"], hidden_size=256, linear_before_reset=1))
    x = g.node("Tanh", g.layer(g.reshape("h", 1, 256), 256, 34))
    g.save(folder / "depth.onnx", [("latent", x, [1, 34]), ("h_out", "h", [1, 1, 256])])


def attention(g, x, memory, rows, others, width=64, heads=4):
    def split(x, count, order):
        x = g.reshape(g.layer(x, width, width), 1, count, heads, width // heads)
        return g.node("Transpose", x, perm=order)

    query = split(x, rows, [0, 2, 1, 3])
    key, value = split(memory, others, [0, 2, 3, 1]), split(memory, others, [0, 2, 1, 3])
    scores = g.node("Mul", g.node("MatMul", query, key), g.constant((width // heads) ** -0.5))
    mixed = g.node("MatMul", g.node("Softmax", scores, axis=-1), value)
    mixed = g.reshape(g.node("Transpose", mixed, perm=[0, 2, 1, 3]), 1, rows, width)
    return g.layer(mixed, width, width)


def normalised(g, x, width=64):
    return g.node("LayerNormalization", x, g.constant(numpy.ones(width)), g.constant(numpy.zeros(width)), axis=-1)


def block(g, x, memory, rows, others):
    x = normalised(g, g.node("Add", x, attention(g, x, memory, rows, others)))
    hidden = g.node("Relu", g.layer(x, 64, 256))
    return normalised(g, g.node("Add", x, g.layer(hidden, 256, 64)))


def act(folder):
    g = Graph(3)
    picture, joints = g.input("picture", 1, 3, 48, 64), g.input("joints", 1, 14)
    x = picture
    for outputs, channels, size in [(32, 3, 5), (64, 32, 3), (64, 64, 3)]:
        x = g.node("Relu", g.convolution(x, outputs, channels, size, strides=[2, 2], pads=[size // 2] * 4))
    x = g.node("Transpose", g.reshape(x, 1, 64, 48), perm=[0, 2, 1])
    x = g.node("Concat", g.reshape(g.layer(joints, 14, 64), 1, 1, 64), x, axis=1)
    x = g.node("Add", x, g.drawn(1, 49, 64, inputs=100))
    for _ in range(2):
        x = block(g, x, x, 49, 49)
    queries = g.node("Add", g.drawn(1, 20, 64, inputs=2), g.reshape(g.layer(joints, 14, 64), 1, 1, 64))
    x = block(g, queries, x, 20, 49)
    g.save(folder / "act.onnx", [("actions", g.layer(x, 64, 14), [1, 20, 14])])


def twins(folder):
    g = Graph(4)
    seen = [g.input(f"obs_{index}", 1, 3, 84, 84) for index in range(2)]
    vector = g.input("obs_2", 1, 8)
    encoded = []
    for x in seen:
        for outputs, channels, size, stride in [(16, 3, 8, 4), (32, 16, 4, 2)]:
            x = g.node("LeakyRelu", g.convolution(x, outputs, channels, size, strides=[stride] * 2), alpha=0.01)
        x = g.layer(g.reshape(x, -1, 2592), 2592, 128)
        encoded.append(g.node("LeakyRelu", x, alpha=0.01))
    x = g.node("Concat", *encoded, vector, axis=1)
    for inputs in (264, 128):
        x = g.layer(x, inputs, 128)
        x = g.node("Mul", x, g.node("Sigmoid", x))
    x = g.node("Clip", g.layer(x, 128, 3), g.constant(-3.0), g.constant(3.0))
    g.save(folder / "twins.onnx", [("continuous_actions", g.node("Div", x, g.constant(3.0)), [1, 3])])


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for make in (atari, depth, act, twins):
        make(folder)
