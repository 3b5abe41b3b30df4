"""Writes ONNX files of the policies that `sortie bench policy` is measured with, weights random.

    venv/bin/pip install numpy onnx
    venv/bin/python benches/policy_files.py runs/policies
    sortie bench policy runs/policies/*.onnx --python venv/bin/python
"""

import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

random = np.random.default_rng(1)


def tensor(name, *sizes, inputs):
    """Weights as layers of so many inputs are initialised."""
    bound = 1 / np.sqrt(inputs)
    return numpy_helper.from_array(random.uniform(-bound, bound, sizes).astype(np.float32), name)


def value(name, *sizes):
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes)


def layer(name, before, after, sizes):
    """A layer's node and its weights."""
    weights = [
        tensor(f"{name}.weight", sizes[1], sizes[0], inputs=sizes[0]),
        tensor(f"{name}.bias", sizes[1], inputs=sizes[0]),
    ]
    names = [before, *(weight.name for weight in weights)]
    return helper.make_node("Gemm", names, [after], transB=1), weights


def write(path, nodes, inputs, outputs, weights):
    graph = helper.make_graph(nodes, path.stem, inputs, outputs, weights)
    opset = helper.make_opsetid("", 17)
    file = helper.make_model(graph, opset_imports=[opset], ir_version=8)
    onnx.checker.check_model(file)
    onnx.save(file, path)


def layers(path, sizes, activation):
    """Layers with an activation between them."""
    nodes, weights, before = [], [], "obs"
    for index, pair in enumerate(zip(sizes, sizes[1:])):
        is_last = index == len(sizes) - 2
        after = "actions" if is_last else f"sum{index}"
        node, own = layer(f"layer{index}", before, after, pair)
        nodes.append(node)
        weights += own
        if not is_last:
            before = f"hidden{index}"
            nodes.append(helper.make_node(activation, [after], [before]))
    write(path, nodes, [value("obs", 1, sizes[0])], [value("actions", 1, sizes[-1])], weights)


def recurrent(path, operator, states, inputs, size, actions):
    """A recurrent unit for one step, and a layer."""
    gates = {"GRU": 3, "LSTM": 4}[operator] * size
    weights = [
        tensor("W", 1, gates, inputs, inputs=size),
        tensor("R", 1, gates, size, inputs=size),
        tensor("B", 1, 2 * gates, inputs=size),
        numpy_helper.from_array(np.array([1, 1, inputs]), "step"),
        numpy_helper.from_array(np.array([1, size]), "row"),
    ]
    given, next_states = [f"{state}_in" for state in states], [f"{state}_out" for state in states]
    settings = {"hidden_size": size} | ({"linear_before_reset": 1} if operator == "GRU" else {})
    head, own = layer("head", "hidden", "actions", (size, actions))
    nodes = [
        helper.make_node("Reshape", ["obs", "step"], ["x"]),
        helper.make_node(operator, ["x", "W", "R", "B", "", *given], ["all", *next_states], **settings),
        helper.make_node("Reshape", ["h_out", "row"], ["hidden"]),
        head,
    ]
    state = lambda name: value(name, 1, 1, size)
    write(
        path,
        nodes,
        [value("obs", 1, inputs), *map(state, given)],
        [value("actions", 1, actions), *map(state, next_states)],
        weights + own,
    )


folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
layers(folder / "mlp-64-64-relu.onnx", [8, 64, 64, 5], "Relu")
layers(folder / "mlp-64-64-tanh.onnx", [8, 64, 64, 5], "Tanh")
layers(folder / "mlp-512-256-128-elu.onnx", [480, 512, 256, 128, 29], "Elu")
recurrent(folder / "gru-256.onnx", "GRU", ["h"], 48, 256, 12)
recurrent(folder / "lstm-256.onnx", "LSTM", ["h", "c"], 48, 256, 12)
