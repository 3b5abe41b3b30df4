"""A policy that Stable-Baselines3 learned, as a plan in its environment.

    pip install sortie gymnasium
    python3 play.py
"""

from pathlib import Path

import gymnasium
import sortie

FOLDER = Path(__file__).parent


def episode(plan, seed):
    """Plays one episode. Returns the observations and the actions."""
    environment = gymnasium.make("CartPole-v1")
    observation, _ = environment.reset(seed=seed)
    observations, actions, over = [], [], False
    while not over:
        action = plan.decide(observation)
        observations.append(observation)
        actions.append(action)
        observation, _, terminated, truncated, _ = environment.step(action)
        over = terminated or truncated
    return observations, actions


def main():
    plan = sortie.Plan(FOLDER / "cartpole.onnx", outputs=["action"])
    _, actions = episode(plan, seed=7)
    print(f"balanced for {len(actions)} steps")


if __name__ == "__main__":
    main()
