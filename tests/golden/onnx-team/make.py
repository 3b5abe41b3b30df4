"""Policies for one agent of `group-matching/8x6x2`, made with onnx alone: run it in this folder.

An agent's row is its cell (6), its group (2) and its own number (8), one-hot each; actions are left, stay, right.
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

CELLS, GROUPS, AGENTS, ACTIONS, HIDDEN = 6, 2, 8, 3, 8
FEATURES = CELLS + GROUPS + AGENTS
FLOAT = TensorProto.FLOAT


def save(name, nodes, inputs, outputs, weights):
    value = lambda item: helper.make_tensor_value_info(item[0], item[2] if len(item) > 2 else FLOAT, item[1])
    tensors = [numpy_helper.from_array(array, key) for key, array in weights.items()]
    graph = helper.make_graph(nodes, name, list(map(value, inputs)), list(map(value, outputs)), tensors)
    opset = helper.make_opsetid("", 17)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=8, producer_name="make.py")
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, f"{name}.onnx")


def walker():
    """Every group has a cell, to which its agents take the shorter way: a unit for each pair of group and cell."""
    units = [(group, cell) for group in range(GROUPS) for cell in range(CELLS)]
    first, second = np.zeros((len(units), FEATURES)), np.zeros((ACTIONS, len(units)))
    for unit, (group, cell) in enumerate(units):
        first[unit, [cell, CELLS + group]] = 1
        way = (group * CELLS // GROUPS - cell) % CELLS
        second[0 if way > CELLS // 2 else 1 if way == 0 else 2, unit] = 1
    weights = {"w1": first, "b1": -np.ones(len(units)), "w2": second, "b2": np.zeros(ACTIONS)}
    nodes = [
        helper.make_node("Gemm", ["obs", "w1", "b1"], ["h"], transB=1),
        helper.make_node("Relu", ["h"], ["r"]),
        helper.make_node("Gemm", ["r", "w2", "b2"], ["logits"], transB=1),
    ]
    weights = {key: array.astype(np.float32) for key, array in weights.items()}
    save("ring_mlp", nodes, [("obs", [1, FEATURES])], [("logits", [1, ACTIONS])], weights)


def remembering(random):
    """A recurrent policy of random weights that sees its last action and masks what is not available."""
    inputs = FEATURES + ACTIONS
    draw = lambda *shape: random.normal(0, 0.6, shape).astype(np.float32)
    weights = {
        "w": draw(1, 3 * HIDDEN, inputs),
        "u": draw(1, 3 * HIDDEN, HIDDEN),
        "b": draw(1, 6 * HIDDEN),
        "w2": draw(ACTIONS, HIDDEN),
        "b2": draw(ACTIONS),
        "lead": np.array([0], np.int64),
        "never": np.array(-1e9, np.float32),
    }
    node = helper.make_node
    nodes = [
        node("Unsqueeze", ["obs", "lead"], ["x"]),
        node("Unsqueeze", ["h", "lead"], ["before"]),
        node("GRU", ["x", "w", "u", "b", "", "before"], ["", "after"], hidden_size=HIDDEN, linear_before_reset=1),
        node("Squeeze", ["after", "lead"], ["h_out"]),
        node("Gemm", ["h_out", "w2", "b2"], ["all"], transB=1),
        node("Where", ["action_mask", "all", "never"], ["logits"]),
    ]
    given = [("obs", [1, inputs]), ("h", [1, HIDDEN]), ("action_mask", [1, ACTIONS], TensorProto.BOOL)]
    save("ring_gru", nodes, given, [("logits", [1, ACTIONS]), ("h_out", [1, HIDDEN])], weights)


walker()
remembering(np.random.default_rng(7))
