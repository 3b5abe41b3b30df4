"""Operators that are taken apart: attention of opset 23, transposed convolutions, recurrent units that go backwards."""

import numpy
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn
from torch.nn import functional

from record import both, path, record

GENERATOR = numpy.random.default_rng(19)


def some(*shape):
    return (GENERATOR.normal(size=shape) / 3).astype(numpy.float32)


def saved(name, nodes, inputs, constants, opset, axes):
    values = [helper.make_tensor_value_info(name, kind, sizes) for name, kind, sizes in inputs]
    outputs = [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [None] * axes)]
    constants = [numpy_helper.from_array(numbers, name) for name, numbers in constants.items()]
    graph = helper.make_graph(nodes, "policy", values, outputs, constants)
    file = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8 if opset < 23 else 11)
    onnx.save(file, path(name))
    record(name, cases=16)


class Attends(nn.Module):
    """A layer of a transformer, a causal one, and one whose heads share keys."""

    def __init__(self):
        super().__init__()
        self.layer = nn.TransformerEncoderLayer(16, 2, 32, batch_first=True, norm_first=True)
        self.causal = nn.Linear(16, 48)
        self.shared = nn.Linear(16, 16)
        self.actions = nn.Linear(16, 4)

    def forward(self, obs):
        x = self.layer(obs)
        query, key, value = self.causal(x).view(1, 5, 3, 4, 4).permute(2, 0, 3, 1, 4).unbind(0)
        x = functional.scaled_dot_product_attention(query, key, value, is_causal=True, scale=0.4)
        key, value = self.shared(x.transpose(1, 2).reshape(1, 5, 16)).view(1, 5, 2, 2, 4).permute(2, 0, 3, 1, 4).unbind(0)
        mask = torch.ones(5, 5, dtype=torch.bool).tril(1)
        x = functional.scaled_dot_product_attention(query, key, value, attn_mask=mask, enable_gqa=True)
        return self.actions(x.transpose(1, 2).reshape(1, 5, 16)[:, -1])


def attention(name):
    """Heads beside each other, masks that come in, rows of earlier steps."""
    heads = {"q_num_heads": 4, "kv_num_heads": 2}
    nodes = [
        helper.make_node("Attention", ["query", "rows", "rows", "visible"], ["first"], is_causal=1, **heads),
        helper.make_node("Reshape", ["first", "apart"], ["heads"]),
        helper.make_node("Attention", ["heads", "heads", "heads", "nearer", "past", "past"], ["second", "keys", "all"]),
        helper.make_node("ReduceSum", ["all", "axis"], ["sum"], keepdims=1),
        helper.make_node("Add", ["second", "sum"], ["actions"]),
    ]
    inputs = [
        ("query", TensorProto.FLOAT, [1, 3, 16]),
        ("rows", TensorProto.FLOAT, [1, 5, 8]),
        ("visible", TensorProto.BOOL, [3, 5]),
    ]
    constants = {
        "apart": numpy.array([1, 4, 3, 4]), "nearer": some(3, 5), "past": some(1, 4, 2, 4), "axis": numpy.array([2]),
    }
    saved(name, nodes, inputs, constants, 23, axes=4)


def transposed(name):
    nodes = [
        helper.make_node(
            "ConvTranspose", ["picture", "first.kernel", "first.bias"], ["first"],
            strides=[2, 3], pads=[1, 0, 2, 1], output_padding=[1, 0], dilations=[1, 2],
        ),
        helper.make_node("Elu", ["first"], ["hidden"]),
        helper.make_node(
            "ConvTranspose", ["hidden", "second.kernel"], ["second"], group=2, strides=[2, 1], auto_pad="SAME_UPPER",
        ),
        helper.make_node("ConvTranspose", ["second", "third.kernel"], ["actions"], pads=[2, 2, 2, 2]),
    ]
    constants = {
        "first.kernel": some(3, 4, 3, 2), "first.bias": some(4), "second.kernel": some(4, 1, 3, 3), "third.kernel": some(2, 1, 2, 2),
    }
    saved(name, nodes, [("picture", TensorProto.FLOAT, [1, 3, 4, 3])], constants, 17, axes=4)


def backwards(name):
    nodes, constants = [], {"axis": numpy.array([1])}
    for unit, gates, more in (("GRU", 3, {"linear_before_reset": 1}), ("LSTM", 4, {}), ("RNN", 1, {})):
        constants |= {f"{unit}.W": some(1, 5 * gates, 6), f"{unit}.R": some(1, 5 * gates, 5), f"{unit}.B": some(1, 10 * gates)}
        weights = [f"{unit}.{part}" for part in "WRB"]
        nodes += [
            helper.make_node(unit, ["history", *weights], [f"{unit}.all", f"{unit}.last"], hidden_size=5, direction="reverse", **more),
            helper.make_node("Squeeze", [f"{unit}.all", "axis"], [f"{unit}.rows"]),
        ]
    units = [f"{unit}.{part}" for unit in ("GRU", "LSTM", "RNN") for part in ("rows", "last")]
    nodes.append(helper.make_node("Concat", units, ["actions"], axis=0))
    saved(name, nodes, [("history", TensorProto.FLOAT, [4, 1, 6])], constants, 17, axes=3)


torch.manual_seed(19)
both("apart_layers", Attends(), (torch.randn(1, 5, 16),), ["obs"], ["actions"], exporters=(True,), opset_version=23, cases=16)
attention("apart_attention")
transposed("apart_transposed")
backwards("apart_backwards")
