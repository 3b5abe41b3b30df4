"""Policies of skrl: its models, which it has no exporter for, exported with their preprocessor by PyTorch's."""

import numpy
import torch
from gymnasium import spaces
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.utils.model_instantiators.torch import categorical_model, gaussian_model

from record import both

torch.manual_seed(1)
OBS = spaces.Box(-5, 5, (10,), numpy.float32)
BOX = spaces.Box(-1, 1, (3,), numpy.float32)
LAYERS = [{"name": "net", "input": "OBSERVATIONS", "layers": [24, 24], "activations": "elu"}]


class Exported(torch.nn.Module):
    """What an agent of skrl does: scale, then act by the mean."""

    def __init__(self, model, key):
        super().__init__()
        self.model, self.key = model, key
        self.scaler = RunningStandardScaler(size=OBS, device="cpu")
        self.scaler(torch.randn(64, 10) * 3 + 1, train=True)
        # Its layers learn their sizes from what they are given first.
        self(torch.zeros(1, 10))

    def forward(self, observation):
        inputs = {"observations": self.scaler(observation), "states": None}
        computed = self.model.compute(inputs, role="policy")
        return computed[0] if self.key is None else computed[1][self.key]


def exported(name, model, output="actions"):
    both(f"skrl_{name}", Exported(model, None), (torch.randn(1, 10),), ["observation"], [output])


space = {"observation_space": OBS, "device": "cpu"}
exported("gaussian", gaussian_model(**space, action_space=BOX, clip_actions=True, network=LAYERS, output="ACTIONS"))
exported("gaussian_tanh", gaussian_model(**space, action_space=BOX, network=LAYERS, output="2 * tanh(ACTIONS)"))
exported("categorical", categorical_model(**space, action_space=spaces.Discrete(4), network=LAYERS, output="ACTIONS"), "logits")
