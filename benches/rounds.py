"""What the PyTorch peers of rounds of updates share.

A program is called with a safetensors file of networks, a batch, drawn actions, and gradients to compare with. It
prints a line of JSON with the comparison; then, for every formulation named on standard input, does one round and
prints `{"cpu_s": S}`.
"""

import json
import struct
import sys
import time

import torch
import torch.nn.functional as F

TYPES = {"F32": torch.float32, "I64": torch.int64}


def read(path):
    """The tensors and the metadata of a safetensors file."""
    with open(path, "rb") as file:
        data = bytearray(file.read())
    start = 8 + struct.unpack("<Q", data[:8])[0]
    header = json.loads(bytes(data[8:start]))
    metadata = header.pop("__metadata__")
    tensors = {}
    for name, entry in header.items():
        first, end = entry["data_offsets"]
        part = data[start + first : start + end]
        tensors[name] = torch.frombuffer(part, dtype=TYPES[entry["dtype"]]).view(entry["shape"])
    return tensors, {key: float(value) for key, value in metadata.items()}


def linear(x, layer):
    """Rows `[B, inputs]`, or of several networks `[n, B, inputs]`."""
    weight, bias = layer
    if x.dim() == 2:
        return F.linear(x, weight, bias)
    return torch.baddbmm(bias[:, None], x, weight.transpose(1, 2))


def one_hot(actions, count):
    return F.one_hot(actions, count).float()


def chosen(values, actions):
    return values.gather(-1, actions[..., None])[..., 0]


class Round:
    """Networks, targets and optimisers; what a round computes is up to those who inherit."""

    def __init__(self, tensors, settings):
        self.tensors, self.settings = tensors, settings
        self.critic, self.policies = self.join("critic."), self.join("policies.")
        copied = lambda network: {name: weight.detach().clone() for name, weight in network.items()}
        self.target_critic, self.target_policies = copied(self.critic), copied(self.policies)
        adam = lambda weights, decay: torch.optim.Adam(
            weights.values(), lr=settings["rate"], weight_decay=decay, **self.optimiser()
        )
        self.optimisers = [adam(self.critic, settings["weight_decay"]), adam(self.policies, 0.0)]

    def optimiser(self):
        return {"foreach": True}

    def named(self, of):
        """The names of a network's tensors, or of its gradients."""
        return [name[len(of) :] for name in self.tensors if name.startswith(of)]

    def join(self, of):
        """Weights that can learn."""
        return {name: self.tensors[of + name].clone().requires_grad_() for name in self.named(of)}

    def layer(self, network, name):
        return network[name + ".weight"], network[name + ".bias"]

    def draw(self, scores, given):
        if given is not None:
            return given
        flat = lambda x: x.softmax(-1).flatten(0, -2).multinomial(1).view(x.shape[:-1])
        return [flat(x) for x in scores]

    def follow(self):
        rate = self.settings["target_rate"]
        with torch.no_grad():
            for target, online in [(self.target_critic, self.critic), (self.target_policies, self.policies)]:
                torch._foreach_lerp_(list(target.values()), list(online.values()), rate)

    def compare(self):
        """One round with the given draws: loss, gradient norm, and the gradients' distance from the given ones."""
        loss = self.learn(self.given)
        got, want = [], []
        for of, network in [("gradient.critic.", self.critic), ("gradient.policies.", self.policies)]:
            given = self.join(of)
            got += [weight.grad.flatten() for weight in network.values()]
            want += [given[name].detach().flatten() for name in network]
        got, want = torch.cat(got), torch.cat(want)
        return {
            "loss": loss.item(),
            "gradient_norm": self.norm.item(),
            "gradient_error": ((got - want).norm() / want.norm()).item(),
        }


def main(formulations):
    torch.set_num_threads(1)
    torch.manual_seed(0)
    tensors, settings = read(sys.argv[1])
    ready = {"torch": torch.__version__}
    for name, formulation in formulations.items():
        ready[name] = formulation(tensors, settings).compare()
    print(json.dumps(ready), flush=True)
    learners = {name: formulation(tensors, settings) for name, formulation in formulations.items()}
    for line in sys.stdin:
        learner = learners[line.strip()]
        start = time.process_time()
        learner.learn([None, None])
        print(json.dumps({"cpu_s": time.process_time() - start}), flush=True)
