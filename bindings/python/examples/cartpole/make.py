"""Learns CartPole with Stable-Baselines3, exports the policy as its documentation says, and records an episode of it.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt && venv/bin/python make.py

writes `cartpole.onnx` and `episode.npz`, which lie beside this script.
"""

from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

FOLDER = Path(__file__).parent
SEED = 7


class Greedy(torch.nn.Module):
    """The export of Stable-Baselines3's documentation: action, value and log-probability of one observation."""

    def __init__(self, policy):
        super().__init__()
        self.policy = policy

    def forward(self, observation):
        return self.policy(observation, deterministic=True)


def main():
    torch.manual_seed(SEED)
    torch.set_num_threads(1)
    model = PPO(
        "MlpPolicy",
        "CartPole-v1",
        policy_kwargs={"net_arch": [32, 32]},
        n_steps=32 * 8,
        batch_size=64,
        gae_lambda=0.8,
        gamma=0.98,
        n_epochs=20,
        learning_rate=1e-3,
        seed=SEED,
        device="cpu",
    )
    model.learn(40_000)
    torch.onnx.export(
        Greedy(model.policy).eval(),
        torch.randn(1, 4),
        FOLDER / "cartpole.onnx",
        opset_version=17,
        input_names=["observation"],
        output_names=["action", "value", "log_probability"],
        dynamo=False,
    )
    environment = gymnasium.make("CartPole-v1")
    observation, _ = environment.reset(seed=SEED)
    observations, actions, over = [], [], False
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observations.append(observation)
        actions.append(int(action))
        observation, _, terminated, truncated, _ = environment.step(int(action))
        over = terminated or truncated
    print(f"{len(actions)} steps")
    # Cases along the first axis, as `sortie verify --npz` reads them.
    np.savez(
        FOLDER / "episode.npz",
        in__observation=np.stack(observations)[:, None],
        out__action=np.array(actions)[:, None],
    )


if __name__ == "__main__":
    main()
