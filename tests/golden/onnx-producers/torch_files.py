"""Modules that people write themselves, by both exporters of PyTorch."""

import torch
from torch import nn
from torch.nn import functional as F

from record import both

torch.manual_seed(1)


def mlp(*sizes, activation=nn.ELU, norm=None, last=None):
    layers = []
    for inputs, outputs in zip(sizes, sizes[1:]):
        layers += [nn.Linear(inputs, outputs)] + ([norm(outputs)] if norm else []) + [activation()]
    layers = layers[: -2 if norm else -1] + ([last()] if last else [])
    return nn.Sequential(*layers)


def export(name, module, *inputs, names=("obs",), outputs=("actions",), **options):
    both(f"torch_{name}", module, inputs, list(names), list(outputs), **({"cases": 32} | options))


OBS = torch.randn(1, 12)
BATCH = {"dynamic_axes": {"obs": {0: "batch"}, "actions": {0: "batch"}}}
ACTIVATIONS = [nn.ELU, nn.CELU, nn.SiLU, nn.Mish, nn.Softplus, nn.GELU, lambda: nn.GELU("tanh"), nn.LeakyReLU, nn.ReLU6, nn.Hardswish,
               nn.Hardsigmoid, nn.Hardtanh, nn.Softsign, nn.PReLU, nn.LogSigmoid, nn.Tanhshrink, nn.SELU]
export("activations", nn.Sequential(*[layer for kind in ACTIVATIONS for layer in (nn.Linear(12, 12), kind())], nn.Linear(12, 4)), OBS)
export("layer_norm", mlp(12, 16, 16, 4, activation=nn.GELU, norm=nn.LayerNorm), OBS)
export("rms_norm", mlp(12, 16, 16, 4, activation=nn.SiLU, norm=nn.RMSNorm), OBS)
export("batch_norm", mlp(12, 16, 16, 4, norm=nn.BatchNorm1d, last=nn.Tanh), OBS)
for opset in [9, 12, 15]:
    export(f"opset{opset}", mlp(12, 16, 16, 4), OBS, exporters=(False,), opset_version=opset, **BATCH)


class Residual(nn.Module):
    def __init__(self):
        super().__init__()
        self.first, self.blocks = nn.Linear(12, 16), nn.ModuleList([mlp(16, 16, 16, norm=nn.LayerNorm) for _ in range(2)])
        self.last = nn.Linear(16, 4)

    def forward(self, obs):
        x = self.first(obs)
        for block in self.blocks:
            x = x + block(x)
        return torch.tanh(self.last(x))


export("residual", Residual(), OBS, **BATCH)


class Unit(nn.Module):
    """A cell between two layers."""

    def __init__(self, cell):
        super().__init__()
        self.first, self.cell, self.last = nn.Linear(12, 16), cell, nn.Linear(16, 4)

    def forward(self, obs, *state):
        x = F.elu(self.first(obs))
        if isinstance(self.cell, nn.LSTMCell):
            hidden, cell = self.cell(x, state)
            return self.last(hidden), hidden, cell
        if isinstance(self.cell, (nn.GRUCell, nn.RNNCell)):
            hidden = self.cell(x, *state)
            return self.last(hidden), hidden
        given = state if isinstance(self.cell, nn.LSTM) else state[0]
        x, after = self.cell(x.unsqueeze(0 if not self.cell.batch_first else 1), given)
        x = self.last(x.squeeze(0 if not self.cell.batch_first else 1))
        return (x, *after) if isinstance(self.cell, nn.LSTM) else (x, after)


STATE, DEEP = torch.randn(1, 16), torch.randn(1, 1, 16)
ONE = {"names": ("obs", "h_in"), "outputs": ("actions", "h_out")}
TWO = {"names": ("obs", "h_in", "c_in"), "outputs": ("actions", "h_out", "c_out")}
export("gru_cell", Unit(nn.GRUCell(16, 16)), OBS, STATE, **ONE)
export("rnn_cell", Unit(nn.RNNCell(16, 16)), OBS, STATE, **ONE)
export("lstm_cell", Unit(nn.LSTMCell(16, 16)), OBS, STATE, STATE.clone(), **TWO)
export("gru", Unit(nn.GRU(16, 16, batch_first=True)), OBS, DEEP, **ONE)
export("rnn", Unit(nn.RNN(16, 16)), OBS, DEEP, **ONE)
export("lstm", Unit(nn.LSTM(16, 16, batch_first=True)), OBS, DEEP, DEEP.clone(), **TWO)


class History(nn.Module):
    """Rapid motor adaptation: a history of observations, flat, through convolutions, beside the newest one."""

    def __init__(self):
        super().__init__()
        self.embed = mlp(12, 8, 8)
        self.convolve = nn.Sequential(nn.Conv1d(8, 8, 5, 2), nn.ReLU(), nn.Conv1d(8, 4, 3, 1), nn.ELU(), nn.Flatten())
        self.policy = mlp(12 + 4 * 6, 16, 4)

    def forward(self, obs):
        history = obs.reshape(-1, 20, 12)
        embedded = self.embed(history).permute(0, 2, 1)
        return self.policy(torch.cat([history[:, -1], self.convolve(embedded)], -1))


export("history", History(), torch.randn(1, 240), cases=8)


class Pictures(nn.Module):
    def __init__(self, pool):
        super().__init__()
        self.see = nn.Sequential(nn.Conv2d(1, 4, 3, padding=1), nn.ReLU(), pool, nn.Conv2d(4, 8, 3, groups=2), nn.BatchNorm2d(8),
                                 nn.ReLU(), nn.AdaptiveAvgPool2d(1), nn.Flatten())
        self.act = mlp(8, 16, 4)

    def forward(self, image):
        return self.act(self.see(image))


SEEN = {"names": ("image",), "cases": 8}
export("max_pool", Pictures(nn.MaxPool2d(2)), torch.randn(1, 1, 12, 10), **SEEN)
export("max_pool_padded", Pictures(nn.MaxPool2d(3, 2, padding=1)), torch.randn(1, 1, 12, 10), **SEEN)
export("average_pool", Pictures(nn.AvgPool2d(2)), torch.randn(1, 1, 12, 10), **SEEN)
export("depthwise", Pictures(nn.Sequential(nn.Conv2d(4, 4, 3, groups=4), nn.Conv2d(4, 4, 1), nn.Hardswish())), torch.randn(1, 1, 12, 10), **SEEN)


class Squashed(nn.Module):
    """The mean and the deviation of a squashed Gaussian."""

    def __init__(self):
        super().__init__()
        self.body = mlp(12, 16, 8)

    def forward(self, obs):
        mean, log_std = self.body(obs).chunk(2, -1)
        return torch.tanh(mean), log_std.clamp(-5, 2).exp()


export("squashed", Squashed(), OBS, outputs=("mean", "std"))


class Heads(nn.Module):
    """Means and logits side by side, as several kinds of actions give them."""

    def __init__(self):
        super().__init__()
        self.body, self.mean, self.logits = mlp(12, 16, 16), nn.Linear(16, 3), nn.Linear(16, 4)
        self.log_std = nn.Parameter(torch.zeros(3))

    def forward(self, obs, state_ins):
        x = self.body(obs)
        mean = self.mean(x)
        return torch.cat([mean, self.log_std.expand_as(mean), self.logits(x)], -1), state_ins


export("heads", Heads(), OBS, torch.zeros(1), names=("obs", "state_ins"), outputs=("output", "state_outs"))
export("heads_open", Heads(), OBS, torch.zeros(1), names=("obs", "state_ins"), outputs=("output", "state_outs"), exporters=(False,),
       dynamic_axes={name: {0: "batch_size"} for name in ("obs", "state_ins", "output", "state_outs")}, opset_version=15)


class Choice(nn.Module):
    def __init__(self):
        super().__init__()
        self.body = mlp(12, 16, 6)

    def forward(self, obs, action_mask):
        logits = self.body(F.normalize(obs, dim=-1))
        masked = logits.masked_fill(~action_mask, float("-inf"))
        return masked.argmax(-1), masked.softmax(-1)


export("choice", Choice(), OBS, torch.ones(1, 6, dtype=torch.bool), names=("obs", "action_mask"), outputs=("action", "probabilities"))


class Features(nn.Module):
    """What observations are made of on robots: a phase, a frame turned, gravity, a clock."""

    def __init__(self):
        super().__init__()
        self.body = mlp(17, 16, 3)
        self.register_buffer("mean", torch.randn(12))
        self.register_buffer("variance", torch.rand(12) + 0.5)

    def forward(self, obs, phase):
        scaled = ((obs - self.mean) / torch.sqrt(self.variance + 1e-8)).clamp(-5, 5)
        q, v = obs[:, :3], obs[:, 3:6]
        turned = torch.cross(q, v, dim=-1)
        length = torch.linalg.norm(obs[:, 6:9], dim=-1, keepdim=True)
        clock = torch.cat([torch.sin(2 * torch.pi * phase), torch.cos(2 * torch.pi * phase)], -1)
        x = torch.cat([scaled[:, 2:], turned / (length + 1e-6), clock, torch.pow(phase, 2), torch.floor(phase * 4)], -1)
        return torch.sign(self.body(x)) * torch.abs(self.body(x)).pow(0.5)


export("features", Features(), OBS, torch.rand(1, 1), names=("obs", "phase"))


class Attention(nn.Module):
    """A transformer's block over a short history."""

    def __init__(self):
        super().__init__()
        self.embed, self.last = nn.Linear(6, 16), nn.Linear(16, 4)
        self.place = nn.Parameter(torch.randn(4, 16))
        self.block = nn.TransformerEncoderLayer(16, 2, 16, batch_first=True, activation="gelu", norm_first=True)

    def forward(self, obs):
        x = self.embed(obs.view(1, 4, 6)) + self.place
        return self.last(self.block(x)[:, -1])


export("attention", Attention(), torch.randn(1, 24))


class Experts(nn.Module):
    """A mixture of experts by soft weights."""

    def __init__(self):
        super().__init__()
        self.gate = mlp(12, 8, 3)
        self.weight, self.bias = nn.Parameter(torch.randn(3, 12, 4)), nn.Parameter(torch.randn(3, 4))

    def forward(self, obs):
        gate = torch.softmax(self.gate(obs), -1)
        each = torch.einsum("bi,eio->beo", obs, self.weight) + self.bias
        return (gate.unsqueeze(-1) * each).sum(1)


export("experts", Experts(), OBS)


class OneHot(nn.Module):
    """A discrete observation."""

    def __init__(self):
        super().__init__()
        self.body = mlp(6, 16, 4)

    def forward(self, obs):
        return self.body(F.one_hot(obs, 6).float())


class Embedding(OneHot):
    def __init__(self):
        super().__init__()
        self.table = nn.Embedding(6, 6)

    def forward(self, obs):
        return self.body(self.table(obs))


WHOLE = {"made": {"obs": lambda generator, shape, kind: generator.integers(0, 6, shape).astype(kind)}}
export("one_hot", OneHot(), torch.tensor([2]), **WHOLE)
export("embedding", Embedding(), torch.tensor([2]), **WHOLE)
