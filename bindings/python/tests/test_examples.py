"""The examples do what their pages say."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import sortie
from conftest import ROOT
from pettingzoo.test import parallel_api_test

EXAMPLES = Path(__file__).parents[1] / "examples"
CARTPOLE = EXAMPLES / "cartpole"
sys.path[:0] = [str(EXAMPLES), str(CARTPOLE)]

import pettingzoo_team  # noqa: E402
import play  # noqa: E402

RECORDED = ROOT / "tests" / "golden" / "group-matching"
USUAL = sorted(path for path in RECORDED.glob("*-8x6x2-*.json") if "limit" not in path.name)


def test_a_plan_acts_as_stable_baselines3_did_over_a_whole_episode():
    plan = sortie.Plan(CARTPOLE / "cartpole.onnx", outputs=["action"])
    with np.load(CARTPOLE / "episode.npz") as recorded:
        seen, done = recorded["in__observation"][:, 0], recorded["out__action"][:, 0]
    assert plan.decide_batch(seen).tolist() == done.tolist()
    observations, actions = play.episode(plan, seed=7)
    assert len(actions) == 500 and actions == done.tolist()
    np.testing.assert_allclose(observations, seen, atol=1e-5)


def test_the_recorded_episode_is_verified_by_three_engines():
    report = sortie.verify(CARTPOLE / "cartpole.onnx", CARTPOLE / "episode.npz", outputs=["action"])
    assert [engine["inputs"] for engine in report["engines"]] == [500, 500, 500]


def test_the_environment_is_one_of_pettingzoo():
    parallel_api_test(pettingzoo_team.GroupMatching(), num_cycles=100)


@pytest.mark.parametrize("path", USUAL, ids=lambda path: path.stem)
def test_the_environment_has_the_recorded_rules(path):
    recorded = json.loads(path.read_text())
    sizes, first = recorded["config"], recorded["initial"]
    environment = pettingzoo_team.GroupMatching(limit=sizes["episode_limit"])
    belongs = np.zeros((sizes["n_groups"], sizes["n_agents"]), bool)
    for group, members in zip(belongs, first["groups"], strict=True):
        group[members] = True
    environment.begin(np.array(first["loc"]), belongs)
    assert environment.features().tolist() == recorded["initial_features"]
    for step, after in zip(recorded["steps"], recorded["frames"][1:], strict=True):
        _, rewards, solved, over, _ = environment.execute(np.array(step["executed"]))
        assert environment.places.tolist() == after["loc"]
        assert environment.matches == after["matches"]
        assert set(rewards.values()) == {step["reward"]}
        assert (solved["agent_0"] or over["agent_0"]) == step["done"]
    assert not environment.agents


def test_the_shipped_team_gathers():
    team, environment = sortie.Bundle(ROOT / "models" / "group-matching"), pettingzoo_team.GroupMatching()
    episodes = [pettingzoo_team.play(team, environment, seed) for seed in range(100)]
    assert all(solved for _, solved in episodes)
    # The team's card says 3.84.
    assert np.mean([steps for steps, _ in episodes]) < 5


def test_examples_are_programs():
    for command, words in (
        ([CARTPOLE / "play.py"], "balanced for 500 steps"),
        ([EXAMPLES / "pettingzoo_team.py", ROOT / "models" / "group-matching"], "gathered after"),
    ):
        done = subprocess.run([sys.executable, *command], capture_output=True, text=True, check=True)
        assert words in done.stdout
