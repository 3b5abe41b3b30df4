"""Policies for one agent of `group-matching/8x6x2`, made with onnx alone: run it in this folder.

An agent's row is its cell (6), its group (2) and its own number (8), one-hot each; actions are left, stay, right.
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

CELLS, GROUPS, AGENTS, ACTIONS, HIDDEN, ROOM = 6, 2, 8, 3, 8, 10
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


def attending(random, name, by_index):
    """The agent's own row asks all rows that it may see; there is room for more entities than there are.

    Both files have the same weights: one finds the own row by its number, the other first.
    """
    draw = lambda *shape: random.normal(0, 0.6, shape).astype(np.float32)
    weights = {
        "wk": draw(FEATURES, HIDDEN),
        "wq": draw(FEATURES, HIDDEN),
        "wv": draw(FEATURES, HIDDEN),
        "w": draw(HIDDEN + FEATURES, ACTIONS),
        "never": np.array(-1e9, np.float32),
    }
    node = helper.make_node
    if by_index:
        mask, given = "visible", [("self_index", [1], TensorProto.INT64)]
        own = [node("Gather", ["entities", "self_index"], ["own"], axis=1)]
        masked = node("Where", ["mask", "scores", "never"], ["open"])
    else:
        mask, given = "pad", []
        weights |= {"start": np.array([0], np.int64), "end": np.array([1], np.int64)}
        own = [node("Slice", ["entities", "start", "end", "end"], ["own"])]
        masked = node("Where", ["mask", "never", "scores"], ["open"])
    weights["one"] = np.array([1], np.int64)
    nodes = own + [
        node("MatMul", ["entities", "wk"], ["keys"]),
        node("Transpose", ["keys"], ["turned"], perm=[0, 2, 1]),
        node("MatMul", ["own", "wq"], ["query"]),
        node("MatMul", ["query", "turned"], ["scores"]),
        node("Unsqueeze", [mask, "one"], ["mask"]),
        masked,
        node("Softmax", ["open"], ["shares"], axis=-1),
        node("MatMul", ["entities", "wv"], ["values"]),
        node("MatMul", ["shares", "values"], ["mixed"]),
        node("Concat", ["mixed", "own"], ["both"], axis=2),
        node("Flatten", ["both"], ["flat"]),
        node("MatMul", ["flat", "w"], ["q"]),
    ]
    given = [("entities", [1, ROOM, FEATURES]), (mask, [1, ROOM], TensorProto.BOOL)] + given
    save(name, nodes, given, [("q", [1, ACTIONS])], weights)


attending(np.random.default_rng(9), "ring_first", False)
attending(np.random.default_rng(9), "ring_index", True)
walker()
remembering(np.random.default_rng(7))
