"""What a strictly typed program writes; mypy reads it, nobody runs it."""

import numpy as np
import sortie
from numpy.typing import NDArray


def act(path: str, observation: NDArray[np.float32], mask: NDArray[np.bool_]) -> int:
    plan = sortie.Plan(path, "exact", outputs=["q"], sizes={"N": 7}, states=["h:h_out"])
    answer: NDArray[np.float32] = plan(observation)
    plan(observation, mask)
    plan({"observation": observation})
    plan(observation=observation)
    action: int = plan.decide(observation, available=mask)
    states = np.zeros((4, 64), np.float32)
    actions: NDArray[np.int64] = plan.decide_batch(np.stack([answer] * 4), states=states)
    plan.state = np.zeros_like(plan.state)
    plan.reset()
    return action + int(actions[0]) + len(plan.inspect()["operators"])


def team(folder: str, entities: NDArray[np.float32]) -> NDArray[np.int64]:
    bundle = sortie.Bundle(folder)
    bundle.reset()
    tasks = bundle.allocate(entities, 2, np.eye(4, 2, dtype=bool), [True, True])
    return tasks + bundle.decide(entities, np.ones((2, 4), bool), np.ones((2, 3), bool), [-1, 0])


def robot(observation: NDArray[np.float32]) -> float:
    with sortie.PolicyClient("legs", inputs={"position": 1}, outputs={"force": 1}, fallback=0, deadline=0.002) as policy:
        policy.begin_episode()
        policy.set_deadline(0.02)
        action: sortie.Action = policy.decide(observation, available=None)
        if action.status == "fallback" or action.lost_state:
            print(action.reason, policy.counters["silent"], policy.schema["actions"])
        force: NDArray[np.float32] = action.outputs
        return float(force[0]) if action.action is None else action.action


def joints(path: str) -> sortie.PolicyClient:
    return sortie.PolicyClient("legs", robot={"joint_names": sortie.Plan(path).robot["joint_names"]})


def files(onnx: str, out: str) -> None:
    try:
        report = sortie.compile(onnx, out, profile="fused")
        print(report["macs"], sortie.verify(onnx, "recorded.npz", sizes={"N": 7})["engines"])
    except sortie.DifferenceError as error:
        print(error.report)
    except (sortie.CompileError, sortie.PlanError, sortie.BundleError, sortie.ServeError) as error:
        print(isinstance(error, sortie.SortieError))
