#!/usr/bin/env python3
"""`sortie bridge --ros2` and `sortie serve --ros2`, read and asked over zenoh by a client that knows ROS 2.

    target/venv/bin/python runtime/ros2/tests/over_zenoh.py [PROGRAM]     # the environment of independent.py

`zenoh-ros2-sdk` has to list the topics of a running team with their types, and to read whole observations, actions and allocations;
then it publishes observations to a policy, and reads the actions. PROGRAM is `target/release/sortie-zenoh` unless it is said.
"""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from queue import Empty, Queue

import numpy
import zenoh
from independent import KEPT, OWN_TEXTS, ROOT, plain

PROGRAM = sys.argv[1] if len(sys.argv) > 1 else str(ROOT / "target/release/sortie-zenoh")
PARTS = [
    "builtin_interfaces/msg/Time",
    "std_msgs/msg/Header",
    "std_msgs/msg/MultiArrayDimension",
    "std_msgs/msg/MultiArrayLayout",
]
DOMAIN = 86
# Nothing is left in /dev/shm, and other sessions of this host are none of ours.
ALONE = {"scouting/multicast/enabled": "false", "transport/shared_memory/enabled": "false"}


def hashed(kind):
    start = f"hash {kind} "
    return next(line.removeprefix(start) for line in KEPT.read_text().splitlines() if line.startswith(start))


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def open_router(port):
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    for key, value in ALONE.items():
        config.insert_json5(key, value)
    return zenoh.open(config)


def wait_for(what, look, seconds=30):
    until = time.monotonic() + seconds
    while not (seen := look()):
        if time.monotonic() > until:
            sys.exit(f"{what}: nothing within {seconds} s")
        time.sleep(0.02)
    return seen


DOMAIN_OF_TEAM = f"over-zenoh-{os.getpid()}"


def is_up():
    asked = [PROGRAM, "control", "info", "--domain", DOMAIN_OF_TEAM]
    return subprocess.run(asked, capture_output=True, check=False).returncode == 0


@contextmanager
def running(*words):
    """A program until it is no longer needed, and then as Ctrl-C ends it."""
    process = subprocess.Popen([PROGRAM, *words, "--domain", DOMAIN_OF_TEAM], cwd=ROOT, stdout=subprocess.DEVNULL)
    try:
        yield process
        assert process.poll() in (None, 0), f"{words} ended with {process.returncode}"
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


class Node:
    """What is read and published in one place."""

    def __init__(self, port):
        self.port = port

    def listen(self, topic, kind, text):
        from zenoh_ros2_sdk import ROS2Subscriber

        heard = Queue()
        ROS2Subscriber(
            topic, kind, heard.put, domain_id=DOMAIN, router_port=self.port, msg_definition=text, type_hash=hashed(kind)
        )
        return heard

    def publisher(self, topic, kind):
        from zenoh_ros2_sdk import ROS2Publisher

        own = {"msg_definition": plain(kind), "type_hash": hashed(kind)}
        return ROS2Publisher(topic, kind, domain_id=DOMAIN, router_port=self.port, **own)

    def topics(self):
        from zenoh_ros2_sdk.discovery import get_topic_names_and_types

        return dict(get_topic_names_and_types(domain_id=DOMAIN, router_port=self.port))


def a_team(node, flags):
    listed = {f"/team/agent_{agent}/{of.lower()}": of for agent in range(5) for of in ("Observation", "Action")}
    listed["/team/allocation"] = "Allocation"
    listed = {topic: [f"sortie_msgs/msg/{of}"] for topic, of in listed.items()}
    with running("up", "models/save-the-city", "--rate", "50", "--episodes", "1000", "--quiet"):
        wait_for("a team", is_up)
        with running("bridge", "--ros2", "--namespace", "/team", *flags):
            wait_for("the topics", lambda: listed.items() <= node.topics().items())
            read = [f"/team/{topic}" for topic in ("agent_3/observation", "agent_3/action", "allocation")]
            heard = [node.listen(topic, listed[topic][0], OWN_TEXTS[listed[topic][0]]) for topic in read]
            observation, action, allocation = (queue.get(timeout=30) for queue in heard)
    assert observation.header.frame_id == action.header.frame_id == "agent_3"
    assert observation.agent == action.agent == 3
    rows = len(observation.entities)
    assert rows > 1 and len(observation.rows) == rows * observation.features, observation
    assert abs(observation.header.stamp.sec - time.time()) < 100
    assert len(allocation.tasks) == 5, allocation
    return rows


def a_policy(client, node, flags):
    kind = "std_msgs/msg/Float32MultiArray"
    serve = ("serve", "examples/embed_c/cart.plan", "--ros2", "--namespace", "/cart", "--deadline-ms", "5000", *flags)
    with running(*serve):
        wait_for("the node", lambda: "/cart/action" in node.topics())
        heard = node.listen("/cart/action", kind, plain(kind))
        observations, resets = node.publisher("/cart/observation", kind), node.publisher("/cart/reset", "std_msgs/msg/Empty")
        layout = client.store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)

        def act(number):
            """Until both ends have met, what is published is lost."""
            while True:
                observations.publish(layout=layout, data=numpy.array([number], dtype="float32"))
                try:
                    return float(heard.get(timeout=0.5).data[0])
                except Empty:
                    pass

        def episode():
            return [act(number) for number in (0.5, -0.25, 1.0)]

        act(0.0)
        resets.publish()
        first = episode()
        assert first != episode(), "the recurrent state goes on"
        resets.publish()
        assert first == episode(), "a reset begins an episode"
        return first


def main():
    os.environ["ZENOH_CONFIG_OVERRIDE"] = ";".join(f"{key}={value}" for key, value in ALONE.items())
    from zenoh_ros2_sdk.session import ZenohSession

    port = free_port()
    session = open_router(port)
    client = ZenohSession.get_instance("127.0.0.1", port)
    for kind in PARTS:
        client.register_message_type(plain(kind), kind)
    flags = ("--router", f"tcp/127.0.0.1:{port}", "--ros-domain", str(DOMAIN), "--quiet")
    rows = a_team(Node(port), flags)
    print(f"a team: its topics are listed, agent 3 saw {rows} entities and acted, an allocation came")
    first = a_policy(client, Node(port), flags)
    print(f"a policy: it answered {first}, the same after a reset")
    client.session.close()
    session.close()


if __name__ == "__main__":
    main()
