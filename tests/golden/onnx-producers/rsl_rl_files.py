"""Policies of RSL-RL: by the exporter of its runner, and by the classic one that Isaac Lab calls."""

import types

import torch
from rsl_rl.models import CNNModel, MLPModel, RNNModel
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from record import FOLDER, path, record

torch.manual_seed(1)
GAUSSIAN = {"class_name": "rsl_rl.modules.distribution:GaussianDistribution"}
SQUASHED = {"class_name": "rsl_rl.modules.distribution:BetaDistribution"}
SPREAD = {"class_name": "rsl_rl.modules.distribution:HeteroscedasticGaussianDistribution"}


def observed(**shapes):
    return TensorDict({name: torch.randn(64, *shape) for name, shape in shapes.items()}, [64])


def policy(kind, shapes, actions, distribution=GAUSSIAN, **options):
    """A policy that has seen some observations, so that it normalises."""
    observations = observed(**shapes)
    model = kind(
        observations, {"actor": list(shapes)}, "actor", actions, hidden_dims=(32, 32),
        obs_normalization=True, distribution_cfg=dict(distribution), **options,
    )
    if kind is not CNNModel:
        model.update_normalization(TensorDict({key: 3 * value + 1 for key, value in observations.items()}, [64]))
    return model


def export(name, model, classic=True, **options):
    runner = types.SimpleNamespace(alg=types.SimpleNamespace(get_policy=lambda: model))
    OnPolicyRunner.export_policy_to_onnx(runner, str(FOLDER), f"rsl_rl_{name}.onnx")
    record(f"rsl_rl_{name}", **options)
    if classic:
        module = model.as_onnx(verbose=False).eval()
        torch.onnx.export(
            module, module.get_dummy_inputs(), path(f"rsl_rl_{name}.isaac_lab"), export_params=True, opset_version=11,
            input_names=module.input_names, output_names=module.output_names, dynamic_axes={}, dynamo=False,
        )
        record(f"rsl_rl_{name}.isaac_lab", **options)


export("mlp", policy(MLPModel, {"policy": [45]}, 12))
export("mlp_groups", policy(MLPModel, {"policy": [12], "height": [9]}, 6, SPREAD, activation="selu"), classic=False)
export("mlp_beta", policy(MLPModel, {"policy": [12]}, 6, SQUASHED), classic=False)
export("gru", policy(RNNModel, {"policy": [16]}, 8, rnn_type="gru", rnn_hidden_dim=24))
export("gru_two_layers", policy(RNNModel, {"policy": [24]}, 8, rnn_type="gru", rnn_hidden_dim=16, rnn_num_layers=2), classic=False)
export("lstm", policy(RNNModel, {"policy": [16]}, 8, rnn_type="lstm", rnn_hidden_dim=24))
export("lstm_two_layers", policy(RNNModel, {"policy": [24]}, 8, rnn_type="lstm", rnn_hidden_dim=16, rnn_num_layers=2), classic=False)
CNN = {"output_channels": [4, 8], "kernel_size": [3, 3], "stride": [1, 2], "norm": "none", "activation": "elu"}
export("cnn", policy(CNNModel, {"policy": [9], "depth": [1, 12, 16]}, 3, cnn_cfg=CNN), cases=8)
POOLED = CNN | {"max_pool": True, "norm": "batch", "global_pool": "avg"}
export("cnn_pooled", policy(CNNModel, {"policy": [9], "depth": [1, 12, 16]}, 3, cnn_cfg=POOLED), cases=8)
