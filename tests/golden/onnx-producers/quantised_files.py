"""One policy in numbers of eight and of 16 bits: by onnxruntime's quantisation, and by onnx.

What numbers of 16 bits answer is recorded of the same numbers widened to 32, as plans compute.
"""

import tempfile

import numpy
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_dynamic, quantize_static

from record import FOLDER, path, record

LAYERS = [12, 24, 16, 5]
GENERATOR = numpy.random.default_rng(7)


def saved(name, nodes, constants, kind=TensorProto.FLOAT):
    inputs = [helper.make_tensor_value_info("obs", kind, [1, LAYERS[0]])]
    outputs = [helper.make_tensor_value_info("scores", kind, [1, LAYERS[-1]])]
    constants = [numpy_helper.from_array(numbers, name) for name, numbers in constants.items()]
    graph = helper.make_graph(nodes, "policy", inputs, outputs, constants)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path(name))


def plain(name, type=numpy.float32, kind=TensorProto.FLOAT):
    """Products, offsets and hyperbolic tangents."""
    nodes, constants, x = [], {}, "obs"
    generator = numpy.random.default_rng(1)
    for layer, (inputs, outputs) in enumerate(zip(LAYERS, LAYERS[1:])):
        weight = generator.normal(size=(inputs, outputs)) / numpy.sqrt(inputs)
        constants[f"weight.{layer}"] = weight.astype(numpy.float16).astype(type)
        constants[f"bias.{layer}"] = generator.normal(size=outputs).astype(numpy.float16).astype(type)
        is_last = layer == len(LAYERS) - 2
        nodes += [
            helper.make_node("MatMul", [x, f"weight.{layer}"], [f"product.{layer}"]),
            helper.make_node("Add", [f"product.{layer}", f"bias.{layer}"], ["scores" if is_last else f"sum.{layer}"]),
        ]
        if not is_last:
            nodes.append(helper.make_node("Tanh", [f"sum.{layer}"], [f"hidden.{layer}"]))
        x = f"hidden.{layer}"
    saved(name, nodes, constants, kind)


class Observations(CalibrationDataReader):
    def __init__(self):
        self.left = iter([{"obs": GENERATOR.normal(size=(1, LAYERS[0])).astype(numpy.float32)} for _ in range(64)])

    def get_next(self):
        return next(self.left, None)


def products(name):
    """A product of whole numbers on scales of their own."""
    weight = GENERATOR.integers(-127, 128, (LAYERS[0], LAYERS[-1]), numpy.int8)
    one = numpy.float32
    constants = {
        "step": one(0.04), "zero": numpy.uint8(120), "weight": weight, "weight.step": one(0.01),
        "weight.zero": numpy.int8(3), "sum.step": one(0.1), "sum.zero": numpy.uint8(140),
    }
    nodes = [
        helper.make_node("QuantizeLinear", ["obs", "step", "zero"], ["whole"]),
        helper.make_node(
            "QLinearMatMul",
            ["whole", "step", "zero", "weight", "weight.step", "weight.zero", "sum.step", "sum.zero"], ["sum"],
        ),
        helper.make_node("DequantizeLinear", ["sum", "sum.step", "sum.zero"], ["scores"]),
    ]
    saved(name, nodes, {key: numpy.asarray(number) for key, number in constants.items()})


def half(name):
    plain(name)
    record(name)
    plain(name, numpy.float16, TensorProto.FLOAT16)


def brain(name):
    """Weights of torch's bfloat16 in a file of 32 bits."""
    weight = torch.randn(LAYERS[0], LAYERS[-1], generator=torch.Generator().manual_seed(1)).bfloat16()
    bits = weight.view(torch.int16).numpy().tobytes()
    nodes = [
        helper.make_node("Cast", ["weight"], ["wide"], to=TensorProto.FLOAT),
        helper.make_node("MatMul", ["obs", "wide"], ["scores"]),
    ]
    saved(name, nodes, {})
    file = onnx.load(path(name))
    file.graph.initializer.append(helper.make_tensor("weight", TensorProto.BFLOAT16, weight.shape, bits, raw=True))
    onnx.save(file, path(name))
    record(name)


with tempfile.TemporaryDirectory() as folder:
    plain("quantised_plain")
    whole = (FOLDER / "quantised_plain.onnx").rename(f"{folder}/plain.onnx")
    quantize_dynamic(whole, path("quantised_dynamic"), weight_type=QuantType.QInt8)
    quantize_static(
        whole, path("quantised_static"), Observations(), quant_format=QuantFormat.QDQ, weight_type=QuantType.QInt8,
    )
    quantize_static(
        whole, path("quantised_channels"), Observations(), quant_format=QuantFormat.QDQ, per_channel=True,
        weight_type=QuantType.QInt8, activation_type=QuantType.QInt8,
    )
products("quantised_products")
for name in ("dynamic", "static", "channels", "products"):
    record(f"quantised_{name}")
half("half")
brain("brain")
