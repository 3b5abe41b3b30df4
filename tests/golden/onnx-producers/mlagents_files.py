"""Policies of Unity's ML-Agents, by its own exporter: continuous, discrete and both, recurrent, over pictures and with goals.

What is drawn at random is not recorded. ML-Agents needs packages of its own (requirements-mlagents.txt).
"""

import numpy
import onnx
import torch
from mlagents.trainers.policy.torch_policy import TorchPolicy
from mlagents.trainers.settings import NetworkSettings
from mlagents.trainers.torch_entities.model_serialization import ModelSerializer
from mlagents.trainers.torch_entities.networks import SimpleActor
from mlagents_envs.base_env import ActionSpec, BehaviorSpec, DimensionProperty, ObservationSpec, ObservationType

from record import FOLDER, path, record

POINT = DimensionProperty.TRANSLATIONAL_EQUIVARIANCE
WITHOUT_CHANCE = "deterministic_"
CONTINUOUS = {"conditional_sigma": False, "tanh_squash": False}


def observed(*shape, kind=ObservationType.DEFAULT):
    points = (POINT,) * (len(shape) - 1)
    return ObservationSpec(shape, (DimensionProperty.NONE, *points), kind, "")


def masks(generator, shape, kind):
    return (generator.random(shape) < 0.7).astype(kind)


def export(name, observations, continuous=0, branches=(), actor=CONTINUOUS, cases=64, earlier=False, **settings):
    torch.manual_seed(1)
    settings = {"hidden_units": 16, "num_layers": 2} | settings
    behaviour = BehaviorSpec(list(observations), ActionSpec(continuous, tuple(branches)))
    policy = TorchPolicy(1, behaviour, NetworkSettings(**settings), SimpleActor, actor)
    for encoder in policy.actor.network_body.observation_encoder.processors:
        if getattr(encoder, "normalizer", None) is not None:
            encoder.normalizer.update(torch.randn(64, *encoder.normalizer.running_mean.shape) * 3 + 1)
    name = f"mlagents_{name}"
    ModelSerializer(policy).export_policy_model(str(FOLDER / name))
    model = onnx.load(path(name))
    outputs = [output.name for output in model.graph.output]
    wanted = [output for output in outputs if output.startswith(WITHOUT_CHANCE) or output == "recurrent_out"]
    record(name, outputs=wanted, cases=cases, action_masks=masks)
    if earlier:
        as_earlier(model, name)


def as_earlier(model, name):
    """Leaves out what earlier versions do not export: the same answers are the likeliest of what they draw."""
    kept = [output for output in model.graph.output if not output.name.startswith(WITHOUT_CHANCE)]
    del model.graph.output[:]
    model.graph.output.extend(kept)
    onnx.save(model, path(name))
    file = FOLDER / f"{name}.npz"
    recorded = {key.replace(WITHOUT_CHANCE, ""): numbers for key, numbers in numpy.load(file).items()}
    numpy.savez(file, **recorded)


export("continuous", [observed(8)], continuous=2, normalize=True)
export("earlier", [observed(8)], continuous=2, earlier=True)
export("earlier_discrete", [observed(8)], branches=[3], earlier=True)
export("squashed", [observed(8), observed(3)], continuous=2, actor={"conditional_sigma": True, "tanh_squash": True})
export("discrete", [observed(8)], branches=[3])
export("several", [observed(8)], branches=[3, 2])
export("both", [observed(8)], continuous=2, branches=[3, 2])
export("lstm", [observed(8)], continuous=2, normalize=True, memory=NetworkSettings.MemorySettings(4, 24))
export("lstm_discrete", [observed(8)], branches=[5], memory=NetworkSettings.MemorySettings(4, 24))
export("pictures", [observed(3, 20, 20), observed(6)], branches=[4], cases=8, hidden_units=8)
export("goal", [observed(6), observed(3, kind=ObservationType.GOAL_SIGNAL)], continuous=2, hidden_units=4)
