"""A robot's program: a cart that is to come to rest at 0, whose policy another process serves.

    sortie serve examples/embed_c/cart.plan --domain cart
    SORTIE_DOMAIN=cart python3 bindings/python/examples/own_robot.py
    SORTIE_DOMAIN=cart python3 bindings/python/examples/own_robot.py latency examples/embed_c/cart.plan

The same program in Rust is examples/own_robot.
"""

import os
import sys
import time

import numpy as np
import sortie

STEPS = 300
PERIOD = 0.005  # seconds from step to step
SECONDS = 0.2  # that a step takes for the simulated cart
PUSH = 3.0  # metres per second squared at a force of 1

ROUNDS, CALLS = 20, 500


def connect(**settings):
    """The policy of the domain that the environment names; one of anything else is refused."""
    domain = os.environ.get("SORTIE_DOMAIN", "default")
    return sortie.PolicyClient(domain, inputs={"position": 1}, outputs={"force": 1}, actions=0, **settings)


def drive(policy, steps=STEPS, period=PERIOD):
    """The control loop. Without an answer in time it acts by the fallback, and goes on. Returns where the cart is."""
    position = velocity = 0.0
    for step in range(steps):
        if step % 100 == 0:
            position, velocity = 1.0, 0.0
            policy.begin_episode()
        began = time.monotonic()
        action = policy.decide([position])
        force = float(action.outputs[0])
        if step % 20 == 0:
            print(f"step {step:3}  position {position:7.4f}  force {force:7.4f}  {action.status}")
        velocity += PUSH * force * SECONDS
        position += velocity * SECONDS
        time.sleep(max(0.0, began + period - time.monotonic()))
    return position


def latency(policy, plan, pause):
    """Microseconds of a decision over shared memory, and of the same plan in this process."""
    observation = np.full(1, 0.5, np.float32)
    calls = {"plan(observation)": lambda: plan(observation), "policy.decide(...)": lambda: policy.decide(observation)}
    took = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            for _ in range(CALLS):
                if pause:
                    time.sleep(pause)
                began = time.perf_counter_ns()
                call()
                took[name].append((time.perf_counter_ns() - began) / 1000)
    for name, times in took.items():
        half, most = np.percentile(times, [50, 99])
        print(f"{name:20} {half:8.2f} us, 99th percentile {most:8.2f}")


def main():
    arguments = sys.argv[1:]
    if arguments[:1] == ["latency"]:
        pause = float(arguments[2]) / 1e6 if len(arguments) > 2 else 0.0
        with connect(deadline=2.0) as policy:
            latency(policy, sortie.Plan(arguments[1]), pause)
            print(policy.counters)
        return
    with connect() as policy:
        position = drive(policy)
        print(f"at {position:.4f} after {STEPS} steps:", policy.counters)


if __name__ == "__main__":
    main()
