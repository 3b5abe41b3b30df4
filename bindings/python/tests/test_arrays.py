"""What is taken as numbers, and what is refused."""

import numpy as np
import pytest
import sortie
from conftest import assert_close, foreign, recorded


@pytest.fixture(scope="module")
def plan():
    return sortie.Plan(foreign("sb3_dqn.classic"))


@pytest.fixture(scope="module")
def observation():
    return recorded("sb3_dqn.classic")["in__observation"][0]


def test_inputs_are_given_in_order_by_name_or_as_a_dict(plan, observation):
    want = plan(observation)
    assert (plan(observation=observation) == want).all()
    assert (plan({"observation": observation}) == want).all()
    assert plan.decide(observation=observation) == plan.decide({"observation": observation})


def test_a_leading_one_comes_out_as_it_went_in(plan, observation):
    assert observation.shape == (1, 8)
    assert plan(observation).shape == (1, 5)
    assert plan(observation[0]).shape == (5,)
    assert (plan(observation)[0] == plan(observation[0])).all()


def test_answers_are_arrays_of_their_own(plan, observation):
    first = plan(observation)
    kept = first.copy()
    plan(observation + 1)
    assert (first == kept).all()
    first[:] = 0
    assert (plan(observation) == kept).all()


@pytest.mark.parametrize(
    "other",
    [
        lambda array: array.astype("f8"),
        lambda array: array.tolist(),
        lambda array: np.stack([array, array], axis=-1)[..., 0],
        lambda array: array.astype(">f4"),
        lambda array: np.frombuffer(b"-" + array.tobytes(), "u1")[1:].view("f4").reshape(array.shape),
    ],
)
def test_what_numpy_makes_float32_of_is_converted(plan, observation, other):
    assert (plan(other(observation)) == plan(observation)).all()


def test_flags_and_whole_numbers_count_as_numbers(plan):
    ones = np.ones((1, 8), "f4")
    for kind in ("?", "i8", "u1"):
        assert (plan(ones.astype(kind)) == plan(ones)).all()


def test_what_is_no_number_is_refused(plan):
    for flawed in (np.ones(8, "c8"), np.array(["a"] * 8), np.array([None] * 8), None):
        with pytest.raises(TypeError, match="`observation` holds .*, needed are numbers that become float32"):
            plan(flawed)


def test_other_shapes_are_refused_by_name(plan):
    for shape in ((7,), (2, 8), (8, 1), (4, 2), (1, 1, 8), ()):
        with pytest.raises(ValueError, match=r"`observation` has the shape .*, needed is \[8\] or \[1, 8\]"):
            plan(np.zeros(shape, "f4"))


def test_missing_and_further_inputs_are_refused(plan, observation):
    for inputs, named in (
        ((), {}),
        ((observation, observation), {}),
        ((observation,), {"other": observation}),
        ((), {"other": observation}),
        (({"observation": observation, "other": observation},), {}),
        (({},), {}),
    ):
        with pytest.raises(TypeError, match="expected 1 input, `observation`"):
            plan(*inputs, **named)


def test_nan_and_infinity_are_refused_and_the_input_named(plan, observation):
    for flaw in (np.nan, np.inf):
        flawed = observation.copy()
        flawed[0, 3] = flaw
        with pytest.raises(sortie.DecideError, match="not a finite number: look at `observation`"):
            plan(flawed)
        with pytest.raises(sortie.DecideError, match="case 1: .*not a finite number"):
            plan.decide_batch(np.stack([observation, flawed]))


def test_masks_of_other_kinds_and_shapes_are_refused(plan, observation):
    with pytest.raises(TypeError, match="`available` holds float64, needed are flags or whole numbers"):
        plan.decide(observation, available=np.ones(5))
    with pytest.raises(ValueError, match=r"`available` has the shape \[4\], needed is \[5\]"):
        plan.decide(observation, available=np.ones(4, bool))
    with pytest.raises(sortie.DecideError, match="no action is available"):
        plan.decide(observation, available=np.zeros(5, np.int8))
    with pytest.raises(ValueError, match=r"`available` has the shape \[5\], needed is \[3, 5\]"):
        plan.decide_batch(np.zeros((3, 8), "f4"), available=np.ones(5, bool))


def test_no_cases_are_no_actions(plan):
    assert plan.decide_batch(np.zeros((0, 8), "f4")).shape == (0,)


def test_a_state_that_nobody_has_is_refused(plan, observation):
    assert plan.state.shape == (0,)
    with pytest.raises(TypeError, match="not recurrent"):
        plan.decide_batch(observation[None], states=np.zeros((1, 4), "f4"))


def test_states_change_only_where_there_was_an_answer():
    plan = sortie.Plan(foreign("epymarl_rnn.classic"))
    observation = recorded("epymarl_rnn.classic")["in__obs"][0]
    plan(observation)
    before = plan.state
    assert before.any()
    with pytest.raises(sortie.DecideError):
        plan(np.full_like(observation, np.nan))
    assert (plan.state == before).all()
    with pytest.raises(ValueError, match=r"`state` has the shape \[3\], needed is \[64\]"):
        plan.state = np.zeros(3, "f4")
    copy = plan.state
    copy[:] = 5
    assert (plan.state == before).all()
    plan.reset()
    assert not plan.state.any()


def test_states_of_many_cases_stay_where_one_cannot_be_decided():
    plan = sortie.Plan(foreign("epymarl_rnn.classic"))
    observations = recorded("epymarl_rnn.classic")["in__obs"][:3].copy()
    observations[2, 0, 0] = np.nan
    states = np.zeros((3, 64), "f4")
    with pytest.raises(sortie.DecideError, match="case 2"):
        plan.decide_batch(observations, states=states)
    assert not states.any()
    for flawed in (None, np.zeros((3, 64)), np.zeros((64, 3), "f4").T):
        with pytest.raises(TypeError, match=r"give `states`, a C-contiguous float32 array \[3, 64\]"):
            plan.decide_batch(observations, states=flawed)
    states.flags.writeable = False
    with pytest.raises(TypeError, match="not writeable|writ"):
        plan.decide_batch(observations[:2], states=states[:2])


def test_several_outputs_are_a_dict_of_the_files_types():
    name = "sb3_ppo_discrete.classic"
    plan, arrays = sortie.Plan(foreign(name), outputs=["action:discrete", "value"]), recorded(name)
    for case in range(8):
        answer = plan(arrays["in__observation"][case])
        assert list(answer) == ["action", "value"]
        for output, got in answer.items():
            want = arrays[f"out__{output}"][case]
            assert got.dtype == want.dtype and got.shape == want.shape
            assert_close(got, want)
        assert plan.decide(arrays["in__observation"][case]) == answer["action"][0]
    assert plan(arrays["in__observation"][0, 0])["value"].shape == (1,)


def test_a_continuous_policy_gives_numbers():
    name = "sb3_dqn.classic"
    plan, observations = sortie.Plan(foreign(name), outputs=["q:continuous"]), recorded(name)["in__observation"]
    assert plan.decide(observations[0]).tobytes() == plan(observations[0]).tobytes()
    assert plan.decide(observations[0, 0]).shape == (5,)
    many = plan.decide_batch(observations)
    assert many.dtype == np.float32 and many.shape == (64, 5)
    assert [row.tobytes() for row in many] == [plan(seen).tobytes() for seen in observations]
    with pytest.raises(TypeError, match="`q` is no choice of actions: `available` is of no use"):
        plan.decide(observations[0], available=np.ones(5, bool))
