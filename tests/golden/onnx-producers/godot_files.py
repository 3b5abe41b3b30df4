"""Policies of Godot RL Agents: by its own exporter of Stable-Baselines3's models."""

import gymnasium
import numpy
import torch
from godot_rl.wrappers.onnx import stable_baselines_export
from godot_rl.wrappers.onnx.stable_baselines_export import export_model_as_onnx
from gymnasium import spaces
from stable_baselines3 import PPO, SAC

from record import path, record

torch.manual_seed(1)
OBS = spaces.Box(-1, 1, (11,), numpy.float32)
SMALL = {"net_arch": [24, 24]}
EXPORT = torch.onnx.export


class Nothing(gymnasium.Env):
    def __init__(self, observations, actions):
        self.observation_space, self.action_space = observations, actions


def export(name, method, actions, observations=None, kind="MultiInputPolicy", exporters=(False, True), **options):
    """The exporter is called as it is; which of PyTorch's exporters it calls depends on PyTorch's version."""
    observations = observations or spaces.Dict({"obs": OBS})
    for dynamo in exporters:
        policy = dict(options.get("policy_kwargs", SMALL))
        model = method(kind, Nothing(observations, actions), policy_kwargs=policy, device="cpu")
        file = f"godot_{name}.{'dynamo' if dynamo else 'classic'}"
        torch.onnx.export = lambda *a, dynamo=dynamo, **given: EXPORT(*a, **given, dynamo=dynamo)
        # Its check wants files of one size of batch; what it compares is recorded here.
        stable_baselines_export.verify_onnx_export = lambda *a, **given: None
        is_array = not isinstance(observations, spaces.Dict)
        keys = None if is_array else list(observations.spaces)
        export_model_as_onnx(model, path(file), use_obs_array=is_array, obs_keys=keys)
        torch.onnx.export = EXPORT
        record(file)


CONTINUOUS = spaces.Box(-1, 1, (4,), numpy.float32)
export("ppo_continuous", PPO, CONTINUOUS)
export("ppo_discrete", PPO, spaces.Discrete(6))
export("ppo_several", PPO, spaces.MultiDiscrete([3, 2, 2]))
export("ppo_array", PPO, CONTINUOUS, OBS, "MlpPolicy")
export("ppo_array_elu", PPO, CONTINUOUS, OBS, "MlpPolicy", policy_kwargs=SMALL | {"activation_fn": torch.nn.ELU})
# The dynamo exporter fails on it with an error of its own.
export("sac", SAC, CONTINUOUS, OBS, "MlpPolicy", exporters=(False,))
