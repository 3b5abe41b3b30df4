"""Makes files with every operator by its defaults, and records what onnxruntime answers to far arguments.

    python3 -m venv venv && venv/bin/pip install onnx==1.23.2 onnxruntime==1.32.0 safetensors==0.6.2 && venv/bin/python make.py

`functions`: a function of every number of `x`, for each operator an output of its name. `rows`: operators over rows.
Attributes are left out, so that each stands by the default of its specification.
"""

import pathlib

import numpy
import onnx
import onnxruntime
import safetensors.numpy
from onnx import TensorProto, helper, numpy_helper

FOLDER = pathlib.Path(__file__).parent
# Around zero, where functions bend; and beyond where exponentials of 32 bits end (88.7) or vanish (-87.3, -103.9).
FAR = [0.0, 1e-30, 1e-6, 1e-3, 0.03, 0.2, 0.5, 0.9, 1.0, 1.5, 2.5, 3.0, 6.0, 9.0, 17.0, 40.0, 87.0, 89.0, 104.0, 120.0, 1e3, 1e6]
BOTH_SIGNS = ["Abs", "Atan", "Ceil", "Cos", "Elu", "Erf", "Floor", "Gelu", "HardSigmoid", "HardSwish", "LeakyRelu",
              "Mish", "Neg", "Relu", "Round", "Selu", "Sigmoid", "Sign", "Sin", "Softplus", "Softsign", "Tanh",
              "ThresholdedRelu", "Asinh", "Celu", "Tan"]
# Those that are defined on a part of the line, or leave the range of 32 bits, and what is taken of it.
PARTS = {"Acos": (-1, 1), "Asin": (-1, 1), "Atanh": (-0.999, 0.999), "Acosh": (1, 1e6), "Log": (1e-30, 1e6),
         "Sqrt": (0, 1e6), "Exp": (-104, 88), "Reciprocal": (1e-3, 1e6), "Cosh": (-88, 88), "Sinh": (-88, 88)}


def save(name, nodes, inputs, outputs, stored=(), version=20):
    infos = [helper.make_tensor_value_info(key, TensorProto.FLOAT, value.shape) for key, value in inputs.items()]
    found = [helper.make_tensor_value_info(key, TensorProto.FLOAT, None) for key in outputs]
    graph = helper.make_graph(nodes, name, infos, found, list(stored))
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", version)], ir_version=9)
    model = onnx.shape_inference.infer_shapes(model)
    onnx.checker.check_model(model)
    onnx.save(model, FOLDER / f"{name}.onnx")
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    answers = dict(zip(outputs, session.run(outputs, inputs)))
    recorded = {f"in__{key}": value for key, value in inputs.items()} | {f"out__{key}": value for key, value in answers.items()}
    safetensors.numpy.save_file({key: numpy.ascontiguousarray(value) for key, value in recorded.items()}, FOLDER / f"{name}.safetensors")


def functions():
    far = numpy.array(FAR, numpy.float32)
    x = numpy.concatenate([far, -far])[None]
    nodes, stored = [], []
    for operator in BOTH_SIGNS:
        nodes.append(helper.make_node(operator, ["x"], [operator.lower()]))
    for operator, ends in PARTS.items():
        limits = [f"{operator}_{end}" for end in ("least", "most")]
        for limit, end in zip(limits, ends):
            stored.append(numpy_helper.from_array(numpy.float32(end), limit))
        nodes.append(helper.make_node("Clip", ["x", *limits], [f"{operator}_part"]))
        nodes.append(helper.make_node(operator, [f"{operator}_part"], [operator.lower()]))
    outputs = [operator.lower() for operator in [*BOTH_SIGNS, *PARTS]]
    save("functions", nodes, {"x": x}, outputs, stored)


def rows():
    generator = numpy.random.default_rng(1)
    pictures = generator.normal(size=(1, 4, 6, 6)).astype(numpy.float32)
    rows = generator.normal(size=(1, 3, 8)).astype(numpy.float32)
    # Rows whose variance is small beside the usual epsilon, and scores that are far apart.
    rows[0, 1] *= 1e-3
    rows[0, 2] *= 60
    pictures[0, 1] *= 1e-3
    nodes, stored = [], []

    def add(operator, inputs, name=None, **attributes):
        nodes.append(helper.make_node(operator, inputs, [name or operator.lower()], **attributes))
        outputs.append(name or operator.lower())

    def weights(name, *shape, positive=False):
        numbers = generator.normal(size=shape).astype(numpy.float32)
        stored.append(numpy_helper.from_array(numpy.abs(numbers) * 1e-4 if positive else numbers, name))
        return name

    outputs = []
    for operator in ["Softmax", "LogSoftmax", "Hardmax", "ReduceMean", "ReduceMax", "ReduceMin", "LpNormalization"]:
        add(operator, ["rows"])
    for operator in ["ReduceSum", "ReduceL1", "ReduceL2", "ReduceSumSquare", "ReduceLogSumExp"]:
        add(operator, ["rows"])
    add("LayerNormalization", ["rows", weights("scale", 8), weights("bias", 8)])
    add("BatchNormalization", ["pictures", *[weights(f"batch{i}", 4) for i in range(3)], weights("batch3", 4, positive=True)])
    add("InstanceNormalization", ["pictures", weights("instance0", 4), weights("instance1", 4)])
    add("Conv", ["pictures", weights("kernel", 2, 4, 3, 3), weights("kernel_bias", 2)])
    add("MaxPool", ["pictures"], kernel_shape=[2, 3])
    add("AveragePool", ["pictures"], kernel_shape=[3, 3], pads=[1, 1, 1, 1])
    add("GlobalAveragePool", ["pictures"])
    add("GlobalMaxPool", ["pictures"])
    add("Flatten", ["pictures"])
    add("Gemm", ["flatten", weights("matrix", 144, 5), weights("matrix_bias", 5)])
    add("PRelu", ["rows", weights("slope", 8)])
    add("Transpose", ["rows"])
    save("rows", nodes, {"rows": rows, "pictures": pictures}, outputs, stored)


functions()
rows()
