"""Every policy of the golden folder gives what was recorded of it."""

import numpy as np
import onnxruntime
import pytest
import sortie
from conftest import FOREIGN, OPTIONS, assert_close, foreign, recorded

NAMES = sorted(path.stem for path in FOREIGN.glob("*.onnx"))
RECURRENT = [name for name in NAMES if "rnn" in name or "recurrent" in name]
STEPS = 100


def opened(name):
    return sortie.Plan(foreign(name), **OPTIONS.get(name, {}))


def by_role(plan, arrays):
    """The recorded inputs, states and outputs in the plan's order."""
    policy = plan.inspect()["policy"]["facts"]
    given = [value["name"] for value in policy["inputs"] if value["role"] != "state"]
    wanted = [value["name"] for value in policy["outputs"] if value["role"] != "state"]
    states = policy["states"]
    return (
        {name: arrays[f"in__{name}"] for name in given},
        [arrays[f"in__{state['input']}"] for state in states],
        {name: arrays[f"out__{name}"] for name in wanted},
        [arrays[f"out__{state['output']}"] for state in states],
    )


def joined(states, case):
    return np.concatenate([state[case].ravel() for state in states]).astype("f4")


def test_there_are_eleven():
    assert len(NAMES) == 11 and len(RECURRENT) == 3


@pytest.mark.parametrize("name", NAMES)
def test_answers_are_those_recorded(name):
    plan = opened(name)
    given, states, wanted, next_states = by_role(plan, recorded(name))
    for case in range(len(next(iter(given.values())))):
        if states:
            plan.state = joined(states, case)
        answer = plan({name: array[case] for name, array in given.items()})
        answers = answer if isinstance(answer, dict) else {next(iter(wanted)): answer}
        assert answers.keys() == wanted.keys()
        for output, got in answers.items():
            want = wanted[output][case]
            if np.issubdtype(want.dtype, np.integer):
                assert got.dtype == want.dtype and (got == want).all()
            else:
                assert got.dtype == np.float32
                assert_close(got, want)
        if states:
            assert_close(plan.state, joined(next_states, case))


@pytest.mark.parametrize("name", NAMES)
def test_a_plan_file_gives_the_bits_that_its_onnx_file_gives(name, tmp_path):
    out = tmp_path / "policy.plan"
    report = sortie.compile(foreign(name), out, **OPTIONS.get(name, {}))
    assert report["flash_bytes"] == out.stat().st_size
    compiled = opened(name)
    given, _, _, _ = by_role(compiled, recorded(name))
    case = {name: array[0] for name, array in given.items()}
    want = numbers(compiled(case))
    for plan in (sortie.Plan(out), sortie.Plan(out.read_bytes())):
        assert repr(plan) == repr(compiled)
        assert numbers(plan(case)) == want
        assert plan.state.tobytes() == compiled.state.tobytes()


def numbers(answer):
    """The bytes of all answers by name."""
    answers = answer if isinstance(answer, dict) else {"": answer}
    return {name: (array.dtype, array.shape, array.tobytes()) for name, array in answers.items()}


@pytest.mark.parametrize("name", RECURRENT)
def test_states_are_kept_for_100_steps_as_onnxruntime_is_fed_them(name):
    plan = opened(name)
    given, states, wanted, _ = by_role(plan, recorded(name))
    session = onnxruntime.InferenceSession(foreign(name), providers=["CPUExecutionProvider"])
    pairs = plan.inspect()["policy"]["facts"]["states"]
    fed = {pair["input"]: np.zeros_like(state[0]) for pair, state in zip(pairs, states, strict=True)}
    kinds = {value.name: value.shape for value in session.get_inputs()}
    names = [value.name for value in session.get_outputs()]
    for step in range(STEPS):
        inputs = {name: array[step % len(array)] for name, array in given.items()}
        feed = {name: array for name, array in {**inputs, **fed}.items() if name in kinds}
        answers = dict(zip(names, session.run(names, feed), strict=True))
        got = plan(inputs)
        for output in wanted:
            assert_close(got, answers[output])
        fed = {pair["input"]: answers[pair["output"]] for pair in pairs}
        assert_close(plan.state, np.concatenate([state.ravel() for state in fed.values()]))
    plan.reset()
    assert not plan.state.any()


@pytest.mark.parametrize("name", ["sb3_dqn.classic", "sb3_ppo_discrete.classic"])
def test_one_case_and_many_decide_alike(name):
    plan = opened(name)
    observations = recorded(name)["in__observation"]
    actions = plan.decide_batch(observations)
    assert actions.dtype == np.int64 and actions.shape == (len(observations),)
    assert [plan.decide(observation) for observation in observations] == actions.tolist()
    available = np.random.default_rng(5).random((len(observations), 5)) < 0.5
    available[:, 4] = True
    masked = plan.decide_batch(observations, available=available)
    singles = [plan.decide(seen, available=mask) for seen, mask in zip(observations, available, strict=True)]
    assert singles == masked.tolist()
    assert available[np.arange(len(masked)), masked].all() and (masked != actions).any()


@pytest.mark.parametrize("name", RECURRENT)
def test_states_of_many_cases_are_replaced_in_place(name):
    plan = opened(name)
    given, states, _, next_states = by_role(plan, recorded(name))
    kept = np.stack([joined(states, case) for case in range(64)])
    plan.decide_batch(given, states=kept)
    for case in range(64):
        assert_close(kept[case], joined(next_states, case))
    assert not plan.state.any()


def test_a_mask_that_the_network_takes_is_given_as_available():
    plan = opened("sb3_maskable_ppo.classic")
    arrays = recorded("sb3_maskable_ppo.classic")
    observations, masks = arrays["in__observation"], arrays["in__action_mask"]
    want = arrays["out__action"].ravel()
    got = [plan.decide(seen, available=mask[0]) for seen, mask in zip(observations, masks, strict=True)]
    assert got == want.tolist()
    assert plan.decide_batch(observations, available=masks[:, 0]).tolist() == want.tolist()
    assert plan.decide(observations[0]) == plan(observations[0], np.ones((1, 5), bool))[0]


def test_five_choices_at_once_are_an_array():
    name = "alma_agent_flat.classic"
    plan, arrays = opened(name), recorded(name)
    given, _, wanted, _ = by_role(plan, arrays)
    case = {name: array[3] for name, array in given.items()}
    scores = wanted["q"][3]
    assert plan.decide(case).tolist() == scores.argmax(-1).tolist()
    available = np.ones(scores.shape[1:], bool)
    available[:, scores[0].argmax(-1)] = False
    masked = np.where(available, scores[0], -np.inf).argmax(-1)
    assert plan.decide(case, available=available).ravel().tolist() == masked.tolist()
    columns = {name: np.asfortranarray(array) for name, array in case.items()}
    assert not columns["entities"].flags.c_contiguous
    assert (plan(columns) == plan(case)).all()
