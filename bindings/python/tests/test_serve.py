"""A policy that another process serves, asked from Python."""

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import sortie
from conftest import ROOT, assert_close, foreign, recorded
from sortie import _compiler

CART = ROOT / "examples" / "embed_c" / "cart.plan"
EXAMPLES = Path(__file__).parents[1] / "examples"
# Longer than any test.
PATIENT = {"deadline": 3600.0, "patience": 60.0}
POSITION, FORCE = {"position": 1}, {"force": 1}
NUMBERS = itertools.count()

sys.path.insert(0, str(EXAMPLES))
import own_robot  # noqa: E402


@contextlib.contextmanager
def served(domain, policy=CART, *flags):
    """The command line's server once it listens, ended by SIGTERM."""
    command = [_compiler.program(), "serve", str(policy), "--domain", domain, *flags]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert any(line.startswith("serving in domain") for line in iter(server.stdout.readline, ""))
        yield server
    finally:
        # One that is stopped cannot end.
        server.send_signal(signal.SIGCONT)
        server.terminate()
        server.communicate()


@pytest.fixture
def domain():
    # Short: it stands in paths of sockets.
    name = f"py{os.getpid()}-{next(NUMBERS)}"
    yield name
    assert [path.name for path in Path("/dev/shm").glob(f"sortie-*-{name}-*")] == []


@pytest.fixture
def robot(domain):
    # The plan has no names: those of the program hold.
    with served(domain) as server, sortie.PolicyClient(domain, inputs=POSITION, outputs=FORCE, **PATIENT) as policy:
        yield policy, server


@pytest.fixture
def ctrl_c():
    """Hears SIGINT, which shells let background programs ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def positions():
    return np.sin(np.arange(50, dtype=np.float32))


def test_served_answers_are_those_of_a_direct_call(robot):
    policy, _ = robot
    plan = sortie.Plan(CART)
    for _ in range(3):
        policy.begin_episode()
        plan.reset()
        for position in positions():
            action = policy.decide([position])
            assert (action.status, action.reason, action.action, action.lost_state) == ("answered", None, None, False)
            assert action.outputs.dtype == np.float32 and action.outputs.tolist() == plan([position]).tolist()
    assert policy.counters["answered"] == 150 and policy.counters["fallbacks"] == 0


def test_inputs_may_be_named_and_have_any_shape(robot):
    policy, _ = robot
    want = sortie.Plan(CART)([0.5])
    for positional, named in (
        ([[[0.5]]], {}),
        ([{"position": np.float64(0.5)}], {}),
        ([], {"position": [0.5]}),
    ):
        policy.begin_episode()
        assert policy.decide(*positional, **named).outputs == want


def test_a_policy_chooses_among_available_actions_and_remembers(domain):
    name = "epymarl_rnn.classic"
    plan, observations = sortie.Plan(foreign(name)), recorded(name)["in__obs"]
    random = np.random.default_rng(0)
    with served(domain, foreign(name)), sortie.PolicyClient(domain, **PATIENT) as policy:
        assert policy.schema["actions"] == 9 and policy.schema["states"][0]["length"] == plan.state.size
        for observation in observations:
            mask = random.random(9) < 0.5
            mask[random.integers(9)] = True
            action = policy.decide(observation, available=mask)
            assert action.action == plan.decide(observation, available=mask)
            assert action.outputs.shape == (9,)
        with pytest.raises(sortie.ServeError, match="input 0 is `speed`"):
            policy.close()
            sortie.PolicyClient(domain, inputs={"speed": policy.schema["inputs"][0]["length"]})
    with served(domain, foreign(name)), sortie.PolicyClient(domain, **PATIENT) as policy:
        free = policy.decide(observations[0])
        plan.reset()
        assert_close(free.outputs, np.ravel(plan(observations[0])))
        assert free.action == np.argmax(free.outputs)
        none = policy.decide(observations[0], available=np.zeros(9, bool))
        assert (none.status, none.reason, none.action) == ("fallback", "no_available_action", None)
        with pytest.raises(ValueError, match=r"`available` has the shape \[8\], needed is \[9\]"):
            policy.decide(observations[0], available=np.ones(8, bool))


def test_what_the_policy_cannot_decide_on_is_the_fallback(robot):
    policy, _ = robot
    held = policy.decide([0.5]).outputs
    refused = policy.decide([np.nan])
    assert (refused.status, refused.reason) == ("fallback", "non_finite")
    assert refused.outputs == held and "fallback (non_finite)" in repr(refused)
    assert policy.counters == {
        **dict.fromkeys(("late", "guarded", "clamped", "silent", "overdue", "foreign", "lost_states"), 0),
        "answered": 1, "fallbacks": 1,
    }


def test_the_guard_that_tripped_is_told(domain):
    plan = ROOT / "tests" / "golden" / "plans" / "guarded-2.3.plan"
    guards = sortie.Plan(plan).guards
    assert (guards["hold"], guards["fallback"], guards["inputs"]["highest"]) == (2, "zero", [1.5])
    assert sortie.Plan(CART).guards is None
    with served(domain, plan), sortie.PolicyClient(domain, inputs=POSITION, outputs=FORCE, **PATIENT) as policy:
        told = [policy.decide([position]) for position in (2.0, 0.5)]
        assert [(action.status, action.reason) for action in told] == [("fallback", "guard")] * 2
        assert [(action.guard, action.guard_index) for action in told] == [("input_range", 0), ("held", None)]
        assert [action.outputs.tolist() for action in told] == [[0.0]] * 2
        assert "fallback (guard) [input_range 0]" in repr(told[0])
        assert (policy.counters["guarded"], policy.counters["fallbacks"]) == (2, 2)


def test_what_does_not_fit_is_an_exception_and_nothing_is_sent(robot):
    policy, _ = robot
    for given, error, words in (
        (([1.0, 2.0],), ValueError, "`position` has 2 numbers, needed are 1"),
        ((), TypeError, "expected 1 input, `position`"),
        (([1j],), TypeError, "`position` holds complex128"),
    ):
        with pytest.raises(error, match=words):
            policy.decide(*given)
    with pytest.raises(TypeError, match="does not choose among actions"):
        policy.decide([1.0], available=[1])
    for name in ("deadline", "patience", "linger"):
        with pytest.raises(ValueError, match=f"`{name}` is a number of seconds"):
            sortie.PolicyClient("python", **{name: -1.0})
    with pytest.raises(ValueError, match="`deadline` is a number of seconds"):
        policy.set_deadline(float("nan"))
    with pytest.raises(ValueError, match="`fallback`: expected `hold`"):
        sortie.PolicyClient("python", fallback="sleep")
    with pytest.raises(ValueError, match="is no domain id"):
        sortie.PolicyClient("No Such")
    assert policy.counters["answered"] == 0


def test_another_policy_another_robot_and_no_server_are_told_apart(robot, domain):
    policy, _ = robot
    for expected, words in (
        ({"inputs": {"position": 2}}, "input 0 is `position` [2] here, `` [1] there"),
        ({"outputs": {}}, "0 outputs here, 1 there"),
        ({"actions": 5}, "actions are 5 here, 0 there"),
    ):
        policy.close()
        with pytest.raises(sortie.ServeError) as refused:
            sortie.PolicyClient(domain, **expected)
        assert refused.value.exit_code == 78
        assert str(refused.value) == f"domain `{domain}` serves another policy: {words}"
    with pytest.raises(ValueError, match="this client is closed"):
        policy.decide([1.0])
    with sortie.PolicyClient(domain, inputs=POSITION, outputs=FORCE, actions=0, **PATIENT) as first:
        assert first.decide([1.0]).status == "answered"
        with pytest.raises(sortie.ServeError, match=f"already taken by process {os.getpid()}") as busy:
            sortie.PolicyClient(domain)
        assert busy.value.exit_code == 75
    with pytest.raises(sortie.ServeError, match="start `sortie serve PLAN") as alone:
        sortie.PolicyClient("python-nobody", patience=0.0)
    assert alone.value.exit_code == 69


def test_a_robot_outlives_a_server_that_is_killed(domain):
    with served(domain) as server:
        policy = sortie.PolicyClient(domain, fallback="zero", **PATIENT)
        assert policy.decide([0.5]).outputs != 0
        server.kill()
        server.wait()
    policy.set_deadline(0.01)
    silent = policy.decide([0.5])
    assert (silent.status, silent.reason, silent.outputs.tolist()) == ("fallback", "silence", [0.0])
    policy.set_deadline(3600.0)
    with served(domain):
        action = policy.decide([0.5])
        assert action.status == "answered" and action.lost_state and policy.counters["lost_states"] == 1
        assert action.outputs == sortie.Plan(CART)([0.5])
        policy.close()


def wait_for_call(policy):
    """Spins until somebody else's call is under way."""
    while True:
        try:
            policy.set_deadline(3600.0)
        except RuntimeError as error:
            return str(error)


def test_other_threads_run_while_an_answer_is_awaited(robot):
    policy, server = robot
    assert policy.decide([0.5]).status == "answered"
    server.send_signal(signal.SIGSTOP)
    answers = []
    waiting = threading.Thread(target=lambda: answers.append(policy.decide([0.25])))
    waiting.start()
    # This thread works, and looks at the counters, while that one waits.
    assert wait_for_call(policy) == "another call of this client is under way"
    assert policy.counters["answered"] == 1 and not answers
    server.send_signal(signal.SIGCONT)
    waiting.join()
    assert answers[0].status == "answered" and policy.counters["answered"] == 2


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_ends_a_wait_for_an_answer_and_the_client_goes_on(robot):
    policy, server = robot
    server.send_signal(signal.SIGSTOP)

    def interrupt():
        wait_for_call(policy)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    other = threading.Thread(target=interrupt)
    with pytest.raises(KeyboardInterrupt):
        other.start()
        # The other thread's own call may come first.
        while True:
            with contextlib.suppress(RuntimeError):
                policy.decide([0.5])
    other.join()
    server.send_signal(signal.SIGCONT)
    assert policy.decide([0.5]).status == "answered"


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_ends_the_wait_for_a_server(domain):
    def interrupt():
        while not any(Path("/dev/shm").glob(f"sortie-*/{domain}")):
            pass
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    other = threading.Thread(target=interrupt)
    other.start()
    with pytest.raises(KeyboardInterrupt):
        sortie.PolicyClient(domain, patience=3600.0)
    other.join()


def test_a_client_goes_from_thread_to_thread(robot):
    policy, _ = robot
    answers = []
    for _ in range(3):
        worker = threading.Thread(target=lambda: answers.append(policy.decide([0.5]).status))
        worker.start()
        worker.join()
    assert answers == ["answered"] * 3


def test_the_example_drives_the_cart(domain):
    with served(domain, CART, "--deadline-ms", "60000"):
        with sortie.PolicyClient(domain, **PATIENT) as policy:
            assert abs(own_robot.drive(policy, steps=100, period=0.0)) < 0.01
        environment = {**os.environ, "SORTIE_DOMAIN": domain}
        command = [sys.executable, EXAMPLES / "own_robot.py"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert "'answered': 300" in done.stdout


def test_what_a_robot_states_is_checked(domain):
    plan = ROOT / "tests" / "golden" / "onnx-written" / "mjlab_velocity.plan"
    joints = sortie.Plan(plan).robot["joint_names"]
    own = {"joint_names": joints, "action_scale": np.full(6, 0.25, np.float32), "normaliser": "file"}
    with served(domain, plan):
        with sortie.PolicyClient(domain, robot=own, **PATIENT) as client:
            assert client.schema["robot"]["stiffness"][2] == 60
        for wrong in [{"joint_names": joints[::-1]}, {"action_scale": [0.5]}, {"normaliser": "none"}]:
            with pytest.raises(sortie.ServeError, match="here, .* there"):
                sortie.PolicyClient(domain, robot=own | wrong, **PATIENT)
    for wrong in [{"joints": joints}, {"normaliser": "files"}]:
        with pytest.raises(ValueError, match="robot|normaliser"):
            sortie.PolicyClient(domain, robot=wrong)
    for wrong in [{"joint_names": "hip"}, {"stiffness": 3}]:
        with pytest.raises(TypeError):
            sortie.PolicyClient(domain, robot=wrong)
