"""A call of a plan beside a call of onnxruntime, in Python, one thread, hot.

    pip install sortie onnxruntime
    python3 bench.py [ONNX...]

Both are called in turn, round after round, with the same numbers. Shown are the median of the rounds and the fastest,
and the median of the rounds' ratios, with the tenth and the ninetieth of a hundred behind it. On a machine that does
other things too, the ratio of the fastest rounds says more.
"""

import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime
import sortie

FOREIGN = Path(__file__).parents[2] / "tests" / "golden" / "onnx-foreign"
# Two layers of 64 between 8 numbers and 5 actions: with ReLU, scores come out; with tanh, the action.
FILES = ["sb3_dqn.classic", "sb3_ppo_discrete.classic"]
ROUNDS, CALLS = 101, 500
PEER = "InferenceSession.run"


def seconds(call):
    start = time.perf_counter_ns()
    for _ in range(CALLS):
        call()
    return (time.perf_counter_ns() - start) / CALLS * 1e-9


def session_of(path):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def bench(path):
    plan, session = sortie.Plan(path), session_of(path)
    facts = plan.inspect()["policy"]["facts"]
    random = np.random.default_rng(0)
    case = {value["name"]: random.normal(size=value["shape"]).astype("f4") for value in facts["inputs"]}
    wanted = [value["name"] for value in facts["outputs"]]
    inputs = tuple(case.values())
    calls = {
        "Plan(...)": lambda: plan(*inputs),
        "Plan.decide(...)": lambda: plan.decide(*inputs),
        PEER: lambda: session.run(wanted, case),
        "nothing": lambda: None,
    }
    answers = {"": plan(*inputs)} if len(wanted) == 1 else plan(*inputs)
    for got, want in zip(answers.values(), session.run(wanted, case), strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-5, atol=1e-5)
    rounds = [{name: seconds(call) for name, call in calls.items()} for _ in range(ROUNDS)]
    print(path.name, plan)
    least = {name: min(each[name] for each in rounds) for name in calls}
    for name in calls:
        median = np.median([each[name] for each in rounds])
        ratios = np.percentile([each[PEER] / each[name] for each in rounds], [50, 10, 90])
        beside = "  {:.1f} times ({:.1f} to {:.1f}), fastest {:.1f}".format(*ratios, least[PEER] / least[name])
        times = f"{median * 1e6:6.2f} us, fastest {least[name] * 1e6:5.2f}"
        print(f"  {name:21} {times}{'' if name in (PEER, 'nothing') else beside}")
    observation = inputs[0].reshape(1, *inputs[0].shape)
    many = np.repeat(observation, 1000, axis=0)
    if len(inputs) == 1 and not facts["states"]:
        batch = np.median([seconds_of_batch(plan, many) for _ in range(ROUNDS)])
        print(f"  {'Plan.decide_batch':21} {batch * 1e6:6.2f} us a case, {len(many)} in a call")


def seconds_of_batch(plan, many):
    start = time.perf_counter_ns()
    plan.decide_batch(many)
    return (time.perf_counter_ns() - start) / len(many) * 1e-9


if __name__ == "__main__":
    for path in [Path(path) for path in sys.argv[1:]] or [FOREIGN / f"{name}.onnx" for name in FILES]:
        bench(path)
