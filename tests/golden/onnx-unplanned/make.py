"""Writes `scatters.onnx`, of which no plan can be made: scores are sums that a recurrent state is scattered to.

Needs onnx 1.23.2. Its answers are easily told: h_out = (obs + h_in) / 2 and q = h_out[4, 2, 0, 5, 1].
"""

from pathlib import Path

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save


def value(name, size):
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size])


constants = {
    "half": np.float32([[0.5]]),
    "zeros": np.zeros([1, 6], np.float32),
    "places": np.int64([[2, 4, 1, 5, 0, 3]]),
    "start": np.int64([0]),
    "end": np.int64([5]),
    "axis": np.int64([1]),
}
graph = helper.make_graph(
    [
        helper.make_node("Add", ["obs", "h_in"], ["sum"], name="sum"),
        helper.make_node("Mul", ["sum", "half"], ["h_out"], name="mean"),
        helper.make_node(
            "ScatterElements", ["zeros", "places", "h_out"], ["sums"], name="scatter", axis=1, reduction="add"
        ),
        helper.make_node("Slice", ["sums", "start", "end", "axis"], ["q"], name="slice"),
    ],
    "scatters",
    [value("obs", 6), value("h_in", 6)],
    [value("q", 5), value("h_out", 6)],
    [numpy_helper.from_array(array, name) for name, array in constants.items()],
)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
checker.check_model(model)
save(model, Path(__file__).with_name("scatters.onnx"))
