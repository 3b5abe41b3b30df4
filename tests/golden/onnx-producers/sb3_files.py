"""Policies of Stable-Baselines3 and sb3-contrib, exported as the documentation of Stable-Baselines3 says."""

import gymnasium
import numpy
import torch
from gymnasium import spaces
from sb3_contrib import QRDQN, TQC, MaskablePPO, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3

from record import both

BOX = spaces.Box(-1, 1, (8,), numpy.float32)
WIDE = spaces.Box(-2, 3, (3,), numpy.float32)
PICTURE = spaces.Box(0, 255, (1, 36, 36), numpy.uint8)
SMALL = {"net_arch": [24, 24]}


class Nothing(gymnasium.Env):
    """An environment that only has spaces."""

    def __init__(self, observations, actions):
        self.observation_space, self.action_space = observations, actions

    def action_masks(self):
        return numpy.ones(self.action_space.n, bool)


def policy(method, observations, actions, kind="MlpPolicy", **options):
    torch.manual_seed(1)
    options = {"policy_kwargs": SMALL, "device": "cpu"} | options
    # Methods add to it.
    options["policy_kwargs"] = dict(options["policy_kwargs"])
    return method(kind, Nothing(observations, actions), **options).policy


class OnPolicy(torch.nn.Module):
    """The documentation's `OnnxableSB3Policy`."""

    def __init__(self, policy):
        super().__init__()
        self.policy = policy

    def forward(self, observation):
        return self.policy(observation, deterministic=True)


class OfActor(torch.nn.Module):
    """The documentation's `OnnxablePolicy` of SAC: what the actor does, its mean squashed."""

    def __init__(self, actor):
        super().__init__()
        self.actor = actor

    def forward(self, observation):
        return self.actor(observation, deterministic=True)


class OfNet(torch.nn.Module):
    """The values of DQN and QRDQN."""

    def __init__(self, net):
        super().__init__()
        self.net = net

    def forward(self, observation):
        return self.net(observation)


class Chosen(torch.nn.Module):
    def __init__(self, policy):
        super().__init__()
        self.policy = policy

    def forward(self, observation):
        return self.policy._predict(observation, deterministic=True)


class Masked(torch.nn.Module):
    """What `MaskablePPO.predict` does: the features, the logits, the masked choice."""

    def __init__(self, policy):
        super().__init__()
        self.policy = policy

    def forward(self, observation, action_mask):
        features = self.policy.extract_features(observation)
        latent, _ = self.policy.mlp_extractor(features)
        logits = self.policy.action_net(latent)
        return torch.where(action_mask, logits, torch.tensor(-1e8)).argmax(-1)


class Recurrent(torch.nn.Module):
    """What `RecurrentPPO.predict` does for one step of an episode."""

    def __init__(self, policy):
        super().__init__()
        self.policy = policy

    def forward(self, observation, hidden, cell, episode_start):
        distribution, states = self.policy.get_distribution(observation, (hidden, cell), episode_start)
        return distribution.get_actions(deterministic=True), states[0], states[1]


def export(name, module, inputs=None, names=("observation",), outputs=("action",), **options):
    inputs = inputs if inputs is not None else (torch.randn(1, 8),)
    both(f"sb3_{name}", module, inputs, list(names), list(outputs), **options)


TRIPLE = ("actions", "values", "log_prob")
CLASSIC = {"exporters": (False,)}
discrete, several = spaces.Discrete(5), spaces.MultiDiscrete([3, 2, 4])
export("ppo_box", OnPolicy(policy(PPO, BOX, WIDE)), outputs=TRIPLE, **CLASSIC)
export("ppo_discrete", OnPolicy(policy(PPO, BOX, discrete)), outputs=TRIPLE, **CLASSIC)
export("ppo_several", OnPolicy(policy(PPO, BOX, several)), outputs=TRIPLE, **CLASSIC)
export("ppo_binary", OnPolicy(policy(PPO, BOX, spaces.MultiBinary(4))), outputs=TRIPLE, **CLASSIC)
export("ppo_sde", OnPolicy(policy(PPO, BOX, WIDE, use_sde=True)), outputs=TRIPLE, **CLASSIC)
squashed = {"policy_kwargs": SMALL | {"squash_output": True}, "use_sde": True}
export("ppo_squashed", OnPolicy(policy(PPO, BOX, WIDE, **squashed)), outputs=TRIPLE, **CLASSIC)
export("a2c", OnPolicy(policy(A2C, BOX, discrete)), outputs=TRIPLE, **CLASSIC)
export("sac", OfActor(policy(SAC, BOX, WIDE).actor), **CLASSIC)
export("td3", Chosen(policy(TD3, BOX, WIDE)))
export("ddpg", Chosen(policy(DDPG, BOX, WIDE)))
export("dqn", OfNet(policy(DQN, BOX, discrete).q_net), outputs=["q_values"])
export("dqn_choice", Chosen(policy(DQN, BOX, discrete)))
export("tqc", OfActor(policy(TQC, BOX, WIDE).actor), **CLASSIC)
export("qrdqn", OfNet(policy(QRDQN, BOX, discrete, policy_kwargs=SMALL | {"n_quantiles": 5}).quantile_net), outputs=["quantiles"])
export("qrdqn_choice", Chosen(policy(QRDQN, BOX, discrete, policy_kwargs=SMALL | {"n_quantiles": 5})))
mask = torch.ones(1, 5, dtype=torch.bool)
export("maskable_ppo", Masked(policy(MaskablePPO, BOX, discrete)), (torch.randn(1, 8), mask), ("observation", "action_mask"))
state = torch.randn(1, 1, 16)
remembers = {"policy_kwargs": SMALL | {"lstm_hidden_size": 16}}
starts = {"made": {"episode_start": lambda generator, shape, kind: (generator.random(shape) < 0.2).astype(kind)}}
for kind, actions in [("discrete", discrete), ("box", WIDE)]:
    export(
        f"recurrent_ppo_{kind}", Recurrent(policy(RecurrentPPO, BOX, actions, "MlpLstmPolicy", **remembers)),
        (torch.randn(1, 8), state, state, torch.zeros(1)), ("observation", "hidden", "cell", "episode_start"),
        ("action", "next_hidden", "next_cell"), **CLASSIC, **starts,
    )
seen = {"policy_kwargs": {"features_extractor_kwargs": {"features_dim": 32}}}
whole = torch.randint(0, 256, (1, 1, 36, 36), dtype=torch.uint8)
dqn = {"policy_kwargs": SMALL | seen["policy_kwargs"], "buffer_size": 10}
export("dqn_cnn", OfNet(policy(DQN, PICTURE, discrete, "CnnPolicy", **dqn).q_net), (whole,), outputs=["q_values"], exporters=(True,), cases=8)
