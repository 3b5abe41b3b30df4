"""Teams decide and allocate as their bundles recorded it."""

import functools
import json
import shutil
import subprocess

import numpy as np
import pytest
import sortie
from conftest import ROOT
from sortie import _compiler

MODELS = ROOT / "models"
PROPOSING = ROOT / "tests/golden/proposing-team"
POINTING = "routing"
# Agents that run options decide by three networks, and are not bound.
OPTIONS = MODELS / "crafting-iron"
TEAMS = sorted(path.name for path in MODELS.iterdir() if path != OPTIONS)
EXACT_AGENTS = 10
ALLOCATING = [name for name in TEAMS if (MODELS / name / "allocator.plan").exists()]


@functools.cache
def opened(name):
    return sortie.Bundle(MODELS / name)


def rows(named, contract):
    """Rows of features, of which recordings leave out zeros."""
    names = contract["feature_names"]
    return np.array([[row.get(name, 0) for name in names] for row in named], "f4")


def flags(places, length):
    return np.isin(np.arange(length), places)


def state_of(case, contract):
    """A recorded state as `allocate` takes it, and what is present in it."""
    entities = rows(case["entities"], contract)
    tasks = 1 + max(max(tasks, default=0) for tasks in case["entity_tasks"])
    belongs = np.array([flags(tasks_of, tasks) for tasks_of in case["entity_tasks"]])
    state = (entities, case["agents"], belongs, flags(case["open_tasks"], tasks))
    return state, flags(case["present"], len(entities))


@pytest.fixture(scope="module", params=TEAMS)
def team(request):
    bundle = opened(request.param)
    return bundle, bundle.inspect()["contract"], json.loads((MODELS / request.param / "golden.json").read_text())


def test_agents_that_run_options_are_refused_with_what_runs_them():
    with pytest.raises(sortie.BundleError, match="crafting-iron.*options are not bound; `sortie run`"):
        sortie.Bundle(OPTIONS)


def test_every_recorded_observation_gets_its_action(team):
    bundle, contract, golden = team
    for case in golden["cases"]:
        entities, me = rows(case["entities"], contract), case["self"]
        agents = max(len(case["last_actions"]), me + 1)
        visible = np.zeros((agents, len(entities)), bool)
        visible[me] = flags(case["visible"], len(entities))
        available = np.zeros((agents, contract["actions"]), np.int8)
        available[me] = np.array(case["available"]) > 0
        last = [-1 if action is None else action for action in case["last_actions"]]
        last += [-1] * (agents - len(last))
        actions = bundle.decide(entities, visible, available, last)
        assert actions[me] == case["action"]
        assert (np.delete(actions, me) == -1).all()


@pytest.mark.parametrize("name", ALLOCATING)
def test_every_recorded_state_gets_its_allocation(name):
    bundle = opened(name)
    contract = bundle.inspect()["contract"]
    cases = json.loads((MODELS / name / "golden.json").read_text())["allocations"]
    # In a build for tests large teams take a while.
    for case in cases[: 1 if name.endswith("large") else 8]:
        state, present = state_of(case, contract)
        entities, tasks = state[0], len(state[3])
        relation = np.zeros((tasks, len(entities), case["relations"]), "f4")
        for task, entries in zip(case["open_tasks"], case["relation"], strict=True):
            for row, column, value in entries:
                relation[task, row, column] = value
        allocation = bundle.allocate(*state, present=present, relation=relation)
        want = [-1 if task is None else task for task in case["allocation"]]
        here = [agent for agent in case["present"] if agent < case["agents"]]
        # Larger teams are searched from a start that the bundle does not record.
        if case["agents"] <= EXACT_AGENTS:
            assert allocation[here].tolist() == [want[agent] for agent in here]
        assert set(allocation[here].tolist()) <= {-1, *case["open_tasks"]}


def test_every_recorded_state_of_an_allocator_that_points_gets_its_allocation():
    bundle = opened(POINTING)
    contract = bundle.inspect()["contract"]
    allocated = set()
    for case in json.loads((MODELS / POINTING / "golden.json").read_text())["allocations"]:
        state, present = state_of(case, contract)
        available = np.array([flags(actions, contract["actions"]) for actions in case["available"]])
        allocation = bundle.allocate(*state, present=present, available=available)
        assert allocation.tolist() == [-1 if task is None else task for task in case["allocation"]]
        allocated |= set(allocation.tolist())
    assert len(allocated) > 5
    with pytest.raises(ValueError, match=r"give `available` \[4, 17\]"):
        bundle.allocate(*state, present=present)
    with pytest.raises(ValueError, match="without `relation` and `proposals`"):
        bundle.allocate(*state, present=present, available=available, proposals=8)
    with pytest.raises(ValueError, match=r"`available` has the shape \[4, 3\]"):
        bundle.allocate(*state, present=present, available=np.ones((4, 3), bool))


@pytest.fixture
def proposing(tmp_path):
    """The recorded team whose allocator proposes."""
    folder = tmp_path / "proposing"
    shutil.copytree(PROPOSING, folder)
    shutil.copy(MODELS / "save-the-city" / "agent.onnx", folder)
    return sortie.Bundle(folder)


def test_proposals_are_those_of_the_command_line(proposing):
    states = json.loads((MODELS / "save-the-city" / "golden.json").read_text())["allocations"]
    contract, asked = proposing.inspect()["contract"], 0
    for recorded in json.loads((PROPOSING / "allocations.json").read_text()):
        for case, want in zip(states, recorded["allocations"], strict=True):
            state, present = state_of(case, contract)
            how = {"proposals": recorded["proposals"], "seed": recorded["seed"]}
            got = proposing.allocate(*state, present=present, **how)
            assert got.tolist() == want
            asked += 1
    assert asked >= 100
    assert proposing.allocate(*state).tolist() == proposing.allocate(*state, proposals=32, seed=0).tolist()


def test_proposals_that_cannot_be_are_refused(proposing):
    state = (np.zeros((4, 58), "f4"), 2, np.eye(4, 2, dtype=bool), [True, True])
    for count, words in [(0, "at least 1"), (257, "at most 256")]:
        with pytest.raises(ValueError, match=words):
            proposing.allocate(*state, proposals=count)
    with pytest.raises(ValueError, match=r"`relation` has the shape \[1\], needed is \[2, 4, 0\]"):
        proposing.allocate(*state, relation=[1.0])
    with pytest.raises(ValueError, match="this one does not"):
        opened("save-the-city").allocate(*state, proposals=8)


def test_what_does_not_fit_is_refused():
    bundle = opened("group-matching")
    entities = np.zeros((8, 16), "f4")
    everybody, available = np.ones((8, 8), bool), np.ones((8, 3), bool)
    assert bundle.decide(entities, everybody, available).shape == (8,)
    with pytest.raises(ValueError, match=r"`entities` has the shape \[8, 15\], needed are at most 128 rows of 16"):
        bundle.decide(entities[:, :15], everybody, available)
    with pytest.raises(ValueError, match=r"`visible` has the shape \[8, 7\], needed is \[8, 8\]"):
        bundle.decide(entities, everybody[:, :7], available)
    with pytest.raises(ValueError, match=r"`available` has the shape \[7, 3\], needed is \[8, 3\]"):
        bundle.decide(entities, everybody, available[:7])
    with pytest.raises(ValueError, match="`visible` has 9 agents; they are the first of 8 entities"):
        bundle.decide(entities, np.ones((9, 8), bool), available)
    with pytest.raises(ValueError, match="`last_actions` holds 3"):
        bundle.decide(entities, everybody, available, [3] * 8)
    with pytest.raises(TypeError, match="`last_actions` has 2 of 8 agents"):
        bundle.decide(entities, everybody, available, [0, 1])
    entities[5, 2] = np.nan
    with pytest.raises(sortie.DecideError, match="agent 0: .*not a finite number"):
        bundle.decide(entities, everybody, available)
    with pytest.raises(ValueError, match="the team has learned no allocator"):
        bundle.allocate(entities, 8, np.ones((8, 1), bool), [True])


def test_what_is_not_present_is_not_looked_at():
    bundle = opened("save-the-city")
    with pytest.raises(ValueError, match="give `relation`") as caught:
        bundle.allocate(np.zeros((4, 58), "f4"), 2, np.eye(4, 2, dtype=bool), [True, True])
    columns = int(str(caught.value).rstrip("]").split(", ")[-1])
    entities, relation = np.zeros((4, 58), "f4"), np.zeros((2, 4, columns), "f4")
    entities[1] = np.nan
    belongs = np.array([[0, 0], [0, 0], [1, 0], [0, 1]])
    asked = (entities, 2, belongs, [True, True])
    assert bundle.allocate(*asked, present=[1, 0, 1, 1], relation=relation)[0] in (0, 1)
    with pytest.raises(sortie.DecideError, match="not a finite number"):
        bundle.allocate(*asked, relation=relation)


def test_an_allocation_needs_what_the_environment_knows():
    bundle = opened("save-the-city")
    entities = np.zeros((4, 58), "f4")
    with pytest.raises(ValueError, match=r"give `relation` \[2, 4, \d+\]"):
        bundle.allocate(entities, 2, np.eye(4, 2, dtype=bool), [True, True])
    with pytest.raises(ValueError, match="agents are the first entities"):
        bundle.allocate(entities, 5, np.eye(4, 2, dtype=bool), [True, True])


def test_a_damaged_bundle_is_refused(tmp_path):
    folder = tmp_path / "team"
    shutil.copytree(MODELS / "group-matching", folder)
    plan = bytearray((folder / "agent.plan").read_bytes())
    plan[-5] ^= 1
    (folder / "agent.plan").write_bytes(plan)
    with pytest.raises(sortie.BundleError, match=str(folder)):
        sortie.Bundle(folder)


@pytest.fixture(scope="module")
def remembering(tmp_path_factory):
    """A team with memory: none is shipped, and the program that the package carries trains too."""
    folder = tmp_path_factory.mktemp("remembering")
    memory = ["--set", "network.memory=16", "--set", "replay.unit=episodes", "--set", "run.final_episodes=2"]
    for words in (
        ["train", "vdn", "--env", "group-matching", "--steps", "400", "--threads", "1", *memory, "--out", "run"],
        ["export", "run", "--out", "team"],
    ):
        subprocess.run([_compiler.program(), *words, "--quiet"], cwd=folder, check=True, capture_output=True)
    return sortie.Bundle(folder / "team")


def frames(count):
    """Agents anywhere, in groups of any size."""
    random = np.random.default_rng(2)
    for _ in range(count):
        cells, groups = np.eye(6)[random.integers(6, size=8)], np.eye(2)[random.integers(2, size=8)]
        yield np.concatenate([cells, groups, np.eye(8)], axis=1).astype("f4")


def test_agents_remember_until_an_episode_begins(remembering):
    assert remembering.inspect()["network"]["hidden"] == 16
    everybody, available = np.ones((8, 8), bool), np.ones((8, 3), bool)

    def play(begins):
        remembering.reset()
        actions = []
        for entities in frames(40):
            if begins:
                remembering.reset()
            actions.append(remembering.decide(entities, everybody, available).tolist())
        return actions

    assert play(False) == play(False)
    assert play(True) == play(True)
    assert play(True) != play(False)


def test_agents_remember_nothing_of_a_frame_that_was_refused(remembering):
    everybody, available = np.ones((8, 8), bool), np.ones((8, 3), bool)
    flawed = next(frames(1))
    flawed[7, 0] = np.inf

    def play(refused):
        remembering.reset()
        actions = []
        for entities in frames(40):
            if refused:
                # Everybody but the last could decide.
                alone = np.eye(8, dtype=bool)
                with pytest.raises(sortie.DecideError, match="agent 7"):
                    remembering.decide(flawed, alone, available)
            actions.append(remembering.decide(entities, everybody, available).tolist())
        return actions

    assert play(True) == play(False)
