"""A PettingZoo environment whose agents are those of a bundle.

    pip install sortie pettingzoo
    python3 pettingzoo_team.py ../../../models/group-matching

Group Matching (dissertation chapter 5): agents on a ring of cells gather, each with its group. Rules as in
`sortie train --env group-matching`, which the shipped team learned them by; the start is drawn by NumPy.
"""

import sys

import gymnasium
import numpy as np
import sortie
from pettingzoo import ParallelEnv

MOVES = np.array([-1, 0, 1])


class GroupMatching(ParallelEnv):
    """Eight agents, six cells, two groups. Everybody sees everybody: a row for each with its cell, groups and number."""

    metadata = {"name": "group_matching", "is_parallelizable": True}

    def __init__(self, agents=8, cells=6, groups=2, noise=0.1, limit=50):
        self.possible_agents = [f"agent_{number}" for number in range(agents)]
        self.agents = []
        self.cells, self.groups, self.noise, self.limit = cells, groups, noise, limit
        self.random = np.random.default_rng()
        features = cells + groups + agents
        self.observation_spaces = {
            agent: gymnasium.spaces.Dict(
                {
                    "entities": gymnasium.spaces.Box(0, 1, (agents, features), np.float32),
                    "visible": gymnasium.spaces.MultiBinary(agents),
                    "action_mask": gymnasium.spaces.MultiBinary(len(MOVES)),
                }
            )
            for agent in self.possible_agents
        }
        self.action_spaces = {agent: gymnasium.spaces.Discrete(len(MOVES)) for agent in self.possible_agents}

    def observation_space(self, agent):
        return self.observation_spaces[agent]

    def action_space(self, agent):
        return self.action_spaces[agent]

    def reset(self, seed=None, options=None):
        if seed is not None:
            self.random = np.random.default_rng(seed)
        count = len(self.possible_agents)
        cuts = np.sort(self.random.integers(count + 1, size=self.groups - 1))
        members = np.split(self.random.permutation(count), cuts)
        belongs = np.zeros((self.groups, count), bool)
        for group, agents in zip(belongs, members, strict=True):
            group[agents] = True
        self.begin(self.random.integers(self.cells, size=count), belongs)
        return self.observations(), {agent: {} for agent in self.agents}

    def begin(self, places, belongs):
        """Starts with these cells `[A]` and groups `[G, A]`."""
        self.agents = list(self.possible_agents)
        self.places, self.belongs, self.steps = places, belongs, 0
        self.matches = self.count_matches()

    def step(self, actions):
        asked = np.array([actions[agent] for agent in self.agents])
        slips = self.random.random(len(asked)) < self.noise
        return self.execute(np.where(slips, self.random.integers(len(MOVES), size=len(asked)), asked))

    def execute(self, actions):
        """Does what happens, chance apart."""
        self.places = (self.places + MOVES[actions]) % self.cells
        before, self.matches = self.matches, self.count_matches()
        self.steps += 1
        reward = -0.1 + 2.5 * (self.matches - before)
        over = self.steps >= self.limit
        solved = self.matches == self.groups and not over
        told = self.observations(), *(
            {agent: value for agent in self.agents} for value in (reward, solved, over, {})
        )
        if solved or over:
            self.agents = []
        return told

    def count_matches(self):
        """Groups whose members share a cell; an empty group always has gathered."""
        return sum(len(set(self.places[group])) <= 1 for group in self.belongs)

    def features(self):
        """A row of features for each agent: its cell, its groups, itself."""
        count = len(self.possible_agents)
        cells = np.eye(self.cells, dtype=np.float32)[self.places]
        groups = self.belongs.T.astype(np.float32)
        return np.concatenate([cells, groups, np.eye(count, dtype=np.float32)], axis=1)

    def observations(self):
        entities, everybody = self.features(), np.ones(len(self.possible_agents), np.int8)
        mask = np.ones(len(MOVES), np.int8)
        return {agent: {"entities": entities, "visible": everybody, "action_mask": mask} for agent in self.agents}


def act(team, observations):
    """The team's actions: one call for all agents."""
    seen = list(observations.values())
    actions = team.decide(
        seen[0]["entities"],
        visible=np.stack([each["visible"] for each in seen]),
        available=np.stack([each["action_mask"] for each in seen]),
    )
    return dict(zip(observations, actions.tolist(), strict=True))


def play(team, environment, seed):
    """One episode; returns the steps that it took, and whether everybody gathered."""
    observations, _ = environment.reset(seed=seed)
    team.reset()
    while environment.agents:
        observations, _, solved, _, _ = environment.step(act(team, observations))
    return environment.steps, all(solved.values())


def main():
    team, environment = sortie.Bundle(sys.argv[1]), GroupMatching()
    episodes = [play(team, environment, seed) for seed in range(20)]
    for steps, solved in episodes:
        print(f"{'gathered' if solved else 'not gathered'} after {steps} steps")


if __name__ == "__main__":
    main()
