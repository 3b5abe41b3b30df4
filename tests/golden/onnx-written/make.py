"""Policies in the node patterns of their producers' exporters, written with onnx's helper, and what onnxruntime answers.

    python make.py [FOLDER [CASES [WIDER [SEED]]]]

Hidden layers are WIDER times as wide as in this folder. Needs onnx 1.23.2, onnxruntime 1.32.0 and numpy.
"""

import pathlib
import sys

import numpy
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

FOLDER = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else pathlib.Path(__file__).parent
CASES = int(sys.argv[2]) if len(sys.argv) > 2 else 12
WIDER = int(sys.argv[3]) if len(sys.argv) > 3 else 1
SEED = int(sys.argv[4]) if len(sys.argv) > 4 else 5
EPISODE = 50

TYPES = {
    "tensor(float)": numpy.float32,
    "tensor(int64)": numpy.int64,
    "tensor(bool)": numpy.bool_,
    "tensor(uint8)": numpy.uint8,
}
KINDS = {
    numpy.float32: TensorProto.FLOAT,
    numpy.int64: TensorProto.INT64,
    numpy.bool_: TensorProto.BOOL,
    numpy.uint8: TensorProto.UINT8,
}


class File:
    """A graph under construction: values are names."""

    def __init__(self, name, opset=17, scope="", **metadata):
        self.name, self.opset, self.scope, self.metadata = name, opset, scope, metadata
        self.generator = numpy.random.default_rng([SEED, sum(name.encode())])
        self.nodes, self.stored, self.inputs, self.outputs = [], [], [], []
        self.states = {}
        self.count = 0

    def input(self, name, *sizes, kind=numpy.float32):
        self.inputs.append(helper.make_tensor_value_info(name, KINDS[kind], list(sizes)))
        return name

    def output(self, name, kind=numpy.float32, rank=2):
        self.outputs.append(helper.make_tensor_value_info(name, KINDS[kind], [None] * rank))

    def state(self, before, after, *sizes):
        self.states[before] = after
        return self.input(before, *sizes)

    def constant(self, numbers, name=None, kind=numpy.float32):
        name = name or f"{self.scope}onnx::{self.count}"
        self.count += 1
        self.stored.append(numpy_helper.from_array(numpy.asarray(numbers, kind), name))
        return name

    def whole(self, *numbers):
        return self.constant(numbers, kind=numpy.int64)

    def weights(self, *shape, name=None):
        inputs = shape[-1] if len(shape) == 2 else numpy.prod(shape[1:])
        return self.constant(self.generator.normal(size=shape) / numpy.sqrt(inputs), name)

    def __call__(self, operator, *inputs, to=None, outputs=1, domain=None, **attributes):
        self.count += 1
        to = to or f"{self.scope}/{operator}_{self.count}_output_0"
        names = [to] if outputs == 1 else to if isinstance(to, list) else [f"{to}.{slot}" for slot in range(outputs)]
        self.nodes.append(helper.make_node(operator, list(inputs), names, name=f"/{operator}_{self.count}", domain=domain, **attributes))
        return names[0] if outputs == 1 else names

    def cast(self, x, kind):
        x = self("Cast", x)
        self.nodes[-1].attribute.append(helper.make_attribute("to", kind))
        return x

    def gemm(self, x, inputs, outputs, to=None, name=None):
        """A layer as PyTorch writes it."""
        weight, bias = (f"{name}.weight", f"{name}.bias") if name else (None, None)
        bias = self.constant(self.generator.normal(size=outputs) / 4, bias)
        return self("Gemm", x, self.weights(outputs, inputs, name=weight), bias, to=to, transB=1)

    def dense(self, x, inputs, outputs, to=None):
        """A layer as TensorFlow and JAX write it."""
        product = self("MatMul", x, self.constant(self.generator.normal(size=(inputs, outputs)) / numpy.sqrt(inputs)))
        return self("Add", product, self.constant(self.generator.normal(size=outputs) / 4), to=to)

    def swish(self, x):
        return self("Mul", x, self("Sigmoid", x))

    def normalised(self, x, size, clip=None):
        """By means and deviations that were seen in training."""
        x = self("Sub", x, self.constant(self.generator.normal(size=(1, size)) * 2, "normalizer.mean"))
        deviation = numpy.exp(self.generator.normal(size=(1, size)) / 2)
        x = self("Div", x, self.constant(deviation, "normalizer.std"))
        return self("Clip", x, self.constant(-clip), self.constant(clip)) if clip else x

    def saved(self, **made):
        graph = helper.make_graph(self.nodes, "main_graph", self.inputs, self.outputs, self.stored)
        sets = [helper.make_opsetid("", self.opset), helper.make_opsetid("ai.onnx.ml", 3)]
        file = helper.make_model(graph, opset_imports=sets, ir_version=8, producer_name="written")
        helper.set_model_props(file, self.metadata)
        onnx.checker.check_model(file)
        path = FOLDER / f"{self.name}.onnx"
        onnx.save(file, path)
        self.record(path, made)

    def record(self, path, made):
        """Runs the file on random numbers, its states fed back."""
        session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        outputs = [output.name for output in session.get_outputs()]
        recorded, state = {}, {}
        for case in range(CASES):
            given = {}
            for value in session.get_inputs():
                shape, kind = [size if isinstance(size, int) else 1 for size in value.shape], TYPES[value.type]
                if value.name in self.states:
                    fresh = numpy.zeros(shape, kind)
                    given[value.name] = fresh if case % EPISODE == 0 else state.get(value.name, fresh)
                else:
                    given[value.name] = made.get(value.name, numbers)(self.generator, shape, kind)
            answers = dict(zip(outputs, session.run(outputs, given)))
            state = {before: answers[after] for before, after in self.states.items()}
            for key, array in [(f"in__{name}", array) for name, array in given.items()] + [
                (f"out__{name}", array) for name, array in answers.items()
            ]:
                recorded.setdefault(key, []).append(array)
        numpy.savez(path.with_suffix(".npz"), **{key: numpy.stack(arrays) for key, arrays in recorded.items()})


def numbers(generator, shape, kind):
    if kind == numpy.uint8:
        return generator.integers(0, 256, shape, kind)
    return generator.normal(size=shape).astype(kind)


def mask(generator, shape, kind):
    """At least one action is available."""
    mask = generator.random(shape) < 0.6
    mask[..., generator.integers(shape[-1])] = True
    return mask.astype(kind)


def seldom(generator, shape, kind):
    return (generator.random(shape) < 0.1).astype(kind)


def places(count):
    return lambda generator, shape, kind: generator.integers(0, count, shape, kind)


def wide(size):
    return size * WIDER


def brax(name, observed, hidden, actions):
    """Brax's PPO, by tf2onnx: a normaliser, swish, the mean of a squashed normal."""
    file = File(name, opset=11)
    x = file.normalised(file.input("obs", "unk__10", observed), observed)
    for inputs, outputs in zip([observed] + hidden, hidden):
        x = file.swish(file.dense(x, inputs, outputs))
    x = file.dense(x, hidden[-1], 2 * actions)
    loc = file("Slice", x, file.whole(0, 0), file.whole(2**31 - 1, actions), file.whole(0, 1))
    file("Tanh", loc, to="continuous_actions")
    file.output("continuous_actions")
    file.saved()


def mjlab(name):
    """mjlab's velocity task by RSL-RL's exporter, with what a robot needs to know."""
    joints = ["hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll"]
    csv = lambda numbers: ",".join(f"{number:.3f}" for number in numbers)
    file = File(
        name, opset=18, joint_names=",".join(joints), joint_stiffness=csv([40, 40, 60, 60, 20, 20]), joint_damping=csv([2, 2, 3, 3, 1, 1]),
        default_joint_pos=csv([0, 0, -0.312, 0.669, -0.363, 0]), action_scale=csv([0.25] * 6),
        observation_names="base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,command", command_names="twist",
    )
    observed, hidden = 27, [wide(32), wide(24)]
    x = file.normalised(file.input("obs", "batch", observed), observed)
    for layer, (inputs, outputs) in enumerate(zip([observed] + hidden, hidden)):
        x = file("Elu", file.gemm(x, inputs, outputs, name=f"actor.{2 * layer}"))
    file.gemm(x, hidden[-1], 6, to="actions", name="actor.4")
    file.output("actions")
    file.saved()


def unit(name, operator, observed, size, actions, names, head):
    """One step of a recurrent unit of PyTorch, an observation and a state [1, 1, H]."""
    file = File(name, opset=17)
    x = file.input("obs", 1, observed)
    gates = {"GRU": 3, "LSTM": 4}[operator]
    x = file("Unsqueeze", file("Relu", file.gemm(x, observed, size)), file.whole(0))
    states = [file.state(before, after, 1, 1, size) for before, after in names]
    weights = [file.constant(file.generator.normal(size=(1, gates * size, size)) / numpy.sqrt(size)) for _ in range(2)]
    bias = file.constant(file.generator.normal(size=(1, 2 * gates * size)) / 4)
    attributes = {"linear_before_reset": 1} if operator == "GRU" else {}
    after = [after for _, after in names]
    outputs = [f"/{operator}_output_0"] + after
    file(operator, x, *weights, bias, "", *states, to=outputs, outputs=len(outputs), hidden_size=size, **attributes)
    x = file("Squeeze", file("Squeeze", outputs[0], file.whole(1)), file.whole(0))
    head(file, x, size, actions)
    for name in after:
        file.output(name, rank=3)
    file.saved()


def mean_action(file, x, size, actions):
    x = file("Elu", file.gemm(x, size, size))
    file.gemm(x, size, actions, to="actions")
    file.output("actions")


def cleanrl(name):
    """CleanRL's PPO of Atari with an LSTM: pictures, `done` that empties the state, logits."""
    size, picture = wide(16), 24
    file = File(name, opset=14)
    x = file("Div", file.cast(file.input("obs", 1, 1, picture, picture, kind=numpy.uint8), TensorProto.FLOAT), file.constant(255))
    for inputs, outputs, kernel, stride in [(1, 6, 6, 3), (6, 8, 3, 2)]:
        kernels = file.weights(outputs, inputs, kernel, kernel)
        bias = file.constant(file.generator.normal(size=outputs) / 4)
        x = file("Relu", file("Conv", x, kernels, bias, kernel_shape=[kernel] * 2, strides=[stride] * 2))
    x = file("Relu", file.gemm(file("Flatten", x), 8 * 9, size))
    done = file.input("done", 1, 1)
    left = file("Sub", file.constant(1), done)
    states = [file("Mul", left, file.state(before, after, 1, 1, size)) for before, after in [("h_in", "h_out"), ("c_in", "c_out")]]
    weights = [file.constant(file.generator.normal(size=(1, 4 * size, size)) / numpy.sqrt(size)) for _ in range(2)]
    bias = file.constant(file.generator.normal(size=(1, 8 * size)) / 4)
    x = file("Unsqueeze", x, file.whole(0))
    file("LSTM", x, *weights, bias, "", *states, to=["/LSTM_output_0", "h_out", "c_out"], outputs=3, hidden_size=size)
    x = file("Squeeze", "/LSTM_output_0", file.whole(0, 1))
    file.gemm(file("Reshape", x, file.whole(1, -1)), size, 5, to="logits")
    for output, rank in [("logits", 2), ("h_out", 3), ("c_out", 3)]:
        file.output(output, rank=rank)
    file.saved(done=seldom)


def stable_baselines(name):
    """PPO as the documentation exports it: action, value and the logarithm of the action's probability."""
    file = File(name, opset=17)
    x = file("Flatten", file.input("input", "batch_size", 14), axis=1)
    policy, value = x, x
    for inputs, outputs in [(14, wide(32)), (wide(32), wide(32))]:
        policy = file("Tanh", file.gemm(policy, inputs, outputs))
        value = file("Tanh", file.gemm(value, inputs, outputs))
    file("Clip", file.gemm(policy, wide(32), 4), file.constant(-1), file.constant(1), to="actions")
    file.gemm(value, wide(32), 1, to="values")
    file.output("actions")
    file.output("values")
    file.saved()


def greedy(name):
    """DQN and the choice of its largest value."""
    file = File(name, opset=15)
    x = file.input("observation", "batch_size", 11)
    for inputs, outputs in [(11, wide(32)), (wide(32), wide(32))]:
        x = file("Relu", file.gemm(x, inputs, outputs))
    q = file.gemm(x, wide(32), 6)
    file("ArgMax", q, to="action", axis=1, keepdims=0)
    file.output("action", numpy.int64, rank=1)
    file.saved()


def maskable(name):
    """sb3-contrib's MaskablePPO: normalised logits, closed ones at -1e8, and the choice."""
    file = File(name, opset=17)
    x = file("Tanh", file.gemm(file.input("observation", 1, 9), 9, wide(32)))
    logits = file.gemm(x, wide(32), 7)
    closed = file("Where", file.input("action_masks", 1, 7, kind=numpy.bool_), logits, file.constant(-1e8))
    sums = file("ReduceLogSumExp", closed, axes=[-1], keepdims=1)
    file("Sub", closed, sums, to="logits")
    file.output("logits")
    file.saved(action_masks=mask)


def infinite(name):
    """Tianshou's and others' masks: minus infinity where an action is closed, then the logarithm of the softmax."""
    file = File(name, opset=18)
    x = file("Relu", file.gemm(file.input("obs", 1, 10), 10, wide(24)))
    logits = file.gemm(x, wide(24), 6)
    closed = file("Not", file.cast(file.input("mask", 1, 6), TensorProto.BOOL))
    logits = file("Where", closed, file.constant(-numpy.inf), logits)
    file("Log", file("Softmax", logits, axis=-1), to="logits")
    file.output("logits")
    file.saved(mask=mask)


def keras(name):
    """A network of Keras by tf2onnx: a layer normalisation in parts, relu, softplus."""
    file = File(name, opset=13)
    size = wide(32)
    x = file.dense(file.input("input_1", "unk__57", 12), 12, size)
    mean = file("ReduceMean", x, axes=[1], keepdims=1)
    centred = file("Sub", x, mean)
    variance = file("ReduceMean", file("Mul", centred, centred), axes=[1], keepdims=1)
    root = file("Sqrt", file("Add", variance, file.constant(1e-3)))
    scale = file("Mul", file("Reciprocal", root), file.constant(1 + file.generator.normal(size=size) / 4))
    x = file("Add", file("Mul", x, scale), file("Sub", file.constant(file.generator.normal(size=size) / 4), file("Mul", mean, scale)))
    x = file("Relu", x)
    x = file("Softplus", file.dense(x, size, size))
    file.dense(x, size, 3, to="dense_2")
    file.output("dense_2")
    file.saved()


def jax(name):
    """jax2onnx: a history through a loop of a constant count."""
    turns, observed, size = 5, 6, wide(16)
    file = File(name, opset=21)
    history = file.input("in_0", turns, observed)
    inner = File(name, opset=21, scope="/body")
    row = inner("Gather", history, "turn", axis=0)
    row = inner("Unsqueeze", row, inner.whole(0))
    sums = inner("Add", inner.dense(row, observed, size), inner.dense("carry_in", size, size))
    inner("Tanh", sums, to="carry_out")
    inner("Identity", "goes_on_in", to="goes_on_out")
    inner("Squeeze", "carry_out", inner.whole(0), to="row_out")
    value = helper.make_tensor_value_info
    body = helper.make_graph(
        inner.nodes, "body",
        [value("turn", TensorProto.INT64, []), value("goes_on_in", TensorProto.BOOL, []), value("carry_in", TensorProto.FLOAT, [1, size])],
        [value("goes_on_out", TensorProto.BOOL, []), value("carry_out", TensorProto.FLOAT, [1, size]), value("row_out", TensorProto.FLOAT, [size])],
        inner.stored,
    )
    count, always = file.constant(turns, kind=numpy.int64), file.constant(True, kind=numpy.bool_)
    first = file.constant(numpy.zeros((1, size)))
    last, rows = file("Loop", count, always, first, outputs=2, body=body)
    mean = file("ReduceMean", rows, file.whole(0), keepdims=1)
    x = file.swish(file.dense(file("Concat", last, mean, axis=1), 2 * size, size))
    file.dense(x, size, 4, to="out_0")
    file.output("out_0")
    file.saved()


def scikit(name):
    """A pipeline of scikit-learn by skl2onnx: StandardScaler, MLPRegressor."""
    file = File(name, opset=15)
    x = file.input("X", None, 8)
    offset, scale = file.generator.normal(size=8), numpy.exp(file.generator.normal(size=8) / 2)
    x = file("Scaler", x, domain="ai.onnx.ml", offset=offset.tolist(), scale=scale.tolist())
    x = file("Normalizer", x, domain="ai.onnx.ml", norm="L2")
    for inputs, outputs in [(8, wide(24)), (wide(24), wide(24))]:
        x = file("Relu", file.dense(x, inputs, outputs))
    x = file.dense(x, wide(24), 2)
    file("Reshape", x, file.whole(-1, 2), to="variable")
    file.output("variable")
    file.saved()


def epymarl(name):
    """EPyMARL's RNN agent: PyTorch's GRUCell, which its exporter takes apart."""
    size, observed = wide(16), 13
    file = File(name, opset=17)
    x = file("Relu", file.gemm(file.input("inputs", 1, observed), observed, size, name="fc1"))
    before = file.state("hidden_state", "h", 1, size)
    parts = [file("Split", file.gemm(value, size, 3 * size), axis=1, outputs=3) for value in (x, before)]
    (reset_x, update_x, new_x), (reset_h, update_h, new_h) = parts
    reset, update = file("Sigmoid", file("Add", reset_x, reset_h)), file("Sigmoid", file("Add", update_x, update_h))
    new = file("Tanh", file("Add", new_x, file("Mul", reset, new_h)))
    file("Add", file("Mul", file("Sub", before, new), update), new, to="h")
    file.gemm("h", size, 9, to="q", name="fc2")
    file.output("q")
    file.output("h")
    file.saved()


def torchrl(name):
    """TorchRL's TanhNormal by PyTorch's newer exporter: the mean upscaled and squashed, the deviation beside it."""
    file = File(name, opset=18)
    x = file.input("observation", "s77", 10)
    for inputs, outputs in [(10, wide(32)), (wide(32), wide(32))]:
        x = file("Tanh", file.gemm(x, inputs, outputs))
    loc, scale = file("Split", file.gemm(x, wide(32), 6), axis=-1, num_outputs=2, outputs=2)
    loc = file("Mul", file("Tanh", file("Div", loc, file.constant(5))), file.constant(5))
    file("Clip", file("Softplus", file("Add", scale, file.constant(0.5413))), file.constant(1e-4), to="clamp_min")
    file("Tanh", loc, to="action")
    file.output("action")
    file.output("clamp_min")
    file.saved()


def ml_agents(name):
    """Unity's ML-Agents, opset 9: clipped normalisation, swish, masked branches and the likeliest action."""
    file = File(name, opset=9)
    x = file.input("obs_0", "batch", 8)
    x = file("Sub", x, file.constant(file.generator.normal(size=8)))
    x = file("Div", x, file.constant(numpy.exp(file.generator.normal(size=8) / 2)))
    x = file("Clip", x, min=-5.0, max=5.0)
    for inputs, outputs in [(8, wide(24)), (wide(24), wide(24))]:
        x = file.swish(file.gemm(x, inputs, outputs))
    logits = file.gemm(x, wide(24), 4)
    available = file.input("action_masks", "batch", 4)
    shares = file("Softmax", logits, axis=1)
    shares = file("Mul", file("Add", shares, file.constant(1e-7)), available)
    shares = file("Div", shares, file("ReduceSum", shares, axes=[1], keepdims=1))
    scores = file("Log", file("Add", shares, file.constant(1e-7)))
    file("ArgMax", scores, to="deterministic_discrete_actions", axis=1, keepdims=1)
    file("Identity", file.constant([3], "version"), to="version_number")
    file.output("version_number", rank=1)
    file.output("deterministic_discrete_actions", numpy.int64)
    file.saved(action_masks=mask)


def attention(name):
    """A set of entities by PyTorch's newer exporter: two heads, a mask of the visible, a residual and a layer norm."""
    rows, size, heads = 6, wide(16), 2
    width = size // heads
    file = File(name, opset=18)
    x = file.dense(file.input("entities", 1, rows, 7), 7, size)
    visible = file.input("mask", 1, rows, kind=numpy.bool_)
    parts = []
    for _ in range(3):
        part = file("Reshape", file.dense(x, size, size), file.whole(1, rows, heads, width))
        parts.append(file("Transpose", part, perm=[0, 2, 1, 3]))
    query, key, value = parts
    scores = file("MatMul", query, file("Transpose", key, perm=[0, 1, 3, 2]))
    scores = file("Div", scores, file.constant(numpy.sqrt(width)))
    seen = file("Unsqueeze", visible, file.whole(1, 2))
    scores = file("Where", seen, scores, file.constant(-1e9))
    mixed = file("MatMul", file("Softmax", scores, axis=-1), value)
    mixed = file("Reshape", file("Transpose", mixed, perm=[0, 2, 1, 3]), file.whole(1, rows, size))
    x = file("Add", x, file.dense(mixed, size, size))
    scale, shift = file.constant(1 + file.generator.normal(size=size) / 4), file.constant(file.generator.normal(size=size) / 4)
    x = file("LayerNormalization", x, scale, shift, axis=-1, epsilon=1e-5)
    pooled = file("ReduceMean", x, file.whole(1), keepdims=0)
    file.dense(file("Relu", pooled), size, 5, to="actions")
    file.output("actions")
    file.saved(mask=mask)


def depth(name):
    """A depth picture made smaller, convolutions and what the robot feels."""
    file = File(name, opset=17)
    picture, felt = file.input("depth", 1, 1, 20, 30), file.input("proprioception", 1, 9)
    x = file("Resize", picture, "", "", file.whole(1, 1, 12, 16), mode="linear", coordinate_transformation_mode="half_pixel")
    for inputs, outputs, kernel, stride, pad in [(1, 4, 3, 2, 1), (4, 6, 3, 1, 0)]:
        bias = file.constant(file.generator.normal(size=outputs) / 4)
        x = file("Conv", x, file.weights(outputs, inputs, kernel, kernel), bias, kernel_shape=[kernel] * 2, strides=[stride] * 2, pads=[pad] * 4)
        x = file("LeakyRelu", x, alpha=0.01)
    x = file("Concat", file("Flatten", x), felt, axis=1)
    x = file("Elu", file.gemm(x, 6 * 4 * 6 + 9, wide(24)))
    file("Tanh", file.gemm(x, wide(24), 5), to="actions")
    file.output("actions")
    file.saved()


def graph_network(name):
    """PyTorch Geometric's message passing: rows of computed places, sums at computed places."""
    nodes, edges, size = 5, 9, wide(12)
    file = File(name, opset=18)
    x, ends = file.input("x", nodes, 6), file.input("edge_index", 2, edges, kind=numpy.int64)
    here, there = [file("Gather", ends, file.constant(side, kind=numpy.int64), axis=0) for side in (0, 1)]
    rows = [file("GatherND", x, file("Unsqueeze", end, file.whole(-1))) for end in (here, there)]
    messages = file("Elu", file.gemm(file("Concat", *rows, axis=-1), 12, size))
    sums = file.constant(numpy.zeros((nodes, size)))
    sums = file("ScatterND", sums, file("Unsqueeze", there, file.whole(-1)), messages, reduction="add")
    x = file("Elu", file.gemm(file("Concat", x, sums, axis=-1), 6 + size, size))
    file.gemm(x, size, 2, to="action")
    file.output("action")
    file.saved(edge_index=places(nodes))


FOLDER.mkdir(parents=True, exist_ok=True)
brax("brax_go1", 31, [wide(32), wide(24), wide(16)], 6)
brax("brax_apollo", 45, [wide(32), wide(32), wide(16)], 9)
mjlab("mjlab_velocity")
unit("rsl_rl_gru", "GRU", 17, wide(16), 5, [("h_in", "h_out")], mean_action)
unit("rsl_rl_lstm", "LSTM", 17, wide(16), 5, [("h_in", "h_out"), ("c_in", "c_out")], mean_action)
unit("sb3_recurrent", "LSTM", 8, wide(16), 3, [("hidden", "next_hidden"), ("cell", "next_cell")], mean_action)
cleanrl("cleanrl_lstm")
stable_baselines("sb3_ppo")
greedy("sb3_dqn")
maskable("sb3_maskable")
infinite("tianshou_masked")
keras("keras_layer_norm")
jax("jax_loop")
scikit("skl_pipeline")
epymarl("epymarl_rnn")
torchrl("torchrl_tanh_normal")
ml_agents("mlagents_branch")
attention("torch_entities")
depth("torch_depth")
graph_network("torch_graph")
