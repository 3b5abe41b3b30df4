"""Learns the policy of this example and writes it as cart.onnx; needs numpy and onnx, and three minutes.

A cart stands on a rail. It measures how far it is from its place, not how fast it goes, and has to come to rest there: it must
remember. A gated recurrent unit of 16 numbers learns that by evolution strategies.
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

H = 16
STEP, PUSH = 0.2, 3.0  # seconds, metres per second squared
SHAPES = [(3 * H, 1), (3 * H, H), (3 * H,), (3 * H,), (1, H), (1,)]
SIZES = [int(np.prod(shape)) for shape in SHAPES]


def parts(flat):
    """Input, recurrent weights and their biases, weights and bias of the force; of many policies at once."""
    ends = np.cumsum(SIZES)
    return [flat[:, end - size:end].reshape(-1, *shape) for end, size, shape in zip(ends, SIZES, SHAPES)]


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def cost(flat, position, velocity):
    """What every policy pays, from all starts on average, in 30 steps."""
    w, r, bw, br, v, c = parts(flat)
    state = np.zeros((len(flat), len(position), H))
    position, velocity = np.tile(position, (len(flat), 1)), np.tile(velocity, (len(flat), 1))
    total = 0
    for step in range(30):
        given = position[..., None] * w[:, None, :, 0] + bw[:, None]
        kept = np.einsum("nkh,ngh->nkg", state, r) + br[:, None]
        update = sigmoid(given[..., :H] + kept[..., :H])
        reset = sigmoid(given[..., H:2 * H] + kept[..., H:2 * H])
        new = np.tanh(given[..., 2 * H:] + reset * kept[..., 2 * H:])
        state = (1 - update) * new + update * state
        force = np.tanh(np.einsum("nkh,nh->nk", state, v[:, 0]) + c)
        velocity = velocity + PUSH * force * STEP
        position = position + velocity * STEP
        late = 1 if step >= 12 else 0.15
        total = total + late * (position**2 + 0.1 * velocity**2) + 0.01 * force**2
    return total.mean(1)


def learn():
    random = np.random.default_rng(7)
    policy = random.normal(0, 0.3, sum(SIZES))
    mean, square, spread = 0, 0, 0.1
    for step in range(1, 1001):
        starts = random.uniform(-1, 1, 12), random.uniform(-0.5, 0.5, 12)
        noise = random.normal(size=(128, len(policy)))
        noise = np.concatenate([noise, -noise])
        rank = cost(policy + spread * noise, *starts).argsort().argsort() / (len(noise) - 1) - 0.5
        gradient = -(rank[:, None] * noise).mean(0) / spread - 0.0005 * policy
        mean, square = 0.9 * mean + 0.1 * gradient, 0.99 * square + 0.01 * gradient**2
        rate = 0.015 if step < 700 else 0.005
        policy = policy + rate * mean / (1 - 0.9**step) / (np.sqrt(square / (1 - 0.99**step)) + 1e-8)
        if step % 100 == 0:
            print(step, cost(policy[None], np.linspace(-1, 1, 9), np.zeros(9)), flush=True)
    return parts(policy[None].astype(np.float32))


def write(w, r, bw, br, v, c):
    def floats(name, shape):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    def node(operator, inputs, *outputs, **attributes):
        return helper.make_node(operator, inputs.split(), outputs, **attributes)

    weights = {"w": w, "r": r, "bw": bw, "br": br, "v": v, "c": c}
    graph = helper.make_graph(
        [
            node("Gemm", "position w bw", "given", transB=1),
            node("Gemm", "state_in r br", "kept", transB=1),
            node("Split", "given", "given_update", "given_reset", "given_new", axis=1),
            node("Split", "kept", "kept_update", "kept_reset", "kept_new", axis=1),
            node("Add", "given_update kept_update", "to_update"),
            node("Sigmoid", "to_update", "update"),
            node("Add", "given_reset kept_reset", "to_reset"),
            node("Sigmoid", "to_reset", "reset"),
            node("Mul", "reset kept_new", "let_through"),
            node("Add", "given_new let_through", "to_new"),
            node("Tanh", "to_new", "new"),
            node("Sub", "state_in new", "apart"),
            node("Mul", "update apart", "stays"),
            node("Add", "new stays", "state_out"),
            node("Gemm", "state_out v c", "pull", transB=1),
            node("Tanh", "pull", "force"),
        ],
        "cart",
        [floats("position", [1, 1]), floats("state_in", [1, H])],
        [floats("force", [1, 1]), floats("state_out", [1, H])],
        [numpy_helper.from_array(value[0], name) for name, value in weights.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, "cart.onnx")


if __name__ == "__main__":
    write(*learn())
