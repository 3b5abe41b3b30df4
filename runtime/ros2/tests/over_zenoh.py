#!/usr/bin/env python3
"""What the crate writes, sent over zenoh to a client that reads ROS 2, and back.

    target/venv/bin/python runtime/ros2/tests/over_zenoh.py     # the environment of independent.py

A plain session of zenoh says the tokens, keys, attachments and bytes of tests/golden/ros2/independent.txt, which are those that
the crate writes (tests/all/golden.rs). `zenoh-ros2-sdk` has to list the topic, with its type, and to hand over every field.
Then it publishes an observation of a policy, and key, attachment and bytes have to be what the crate reads.
"""

import os
import socket
import sys
import time

import numpy
import zenoh
from independent import KEPT, MESSAGES, OWN_TEXTS, plain

PARTS = [
    "builtin_interfaces/msg/Time",
    "std_msgs/msg/Header",
    "std_msgs/msg/MultiArrayDimension",
    "std_msgs/msg/MultiArrayLayout",
]
# Nothing is left in /dev/shm, and other sessions of this host are none of ours.
ALONE = {"scouting/multicast/enabled": "false", "transport/shared_memory/enabled": "false"}


def kept(kind, name):
    start = f"{kind} {name} "
    return next(line.removeprefix(start) for line in KEPT.read_text().splitlines() if line.startswith(start))


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def open_plain(port):
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    for key, value in ALONE.items():
        config.insert_json5(key, value)
    return zenoh.open(config)


def wait_for(what, look, seconds=10):
    until = time.monotonic() + seconds
    while not (seen := look()):
        if time.monotonic() > until:
            sys.exit(f"{what}: nothing within {seconds} s")
        time.sleep(0.02)
    return seen


def from_the_crate(session, port):
    from zenoh_ros2_sdk import ROS2Subscriber
    from zenoh_ros2_sdk.discovery import get_topic_info, get_topic_names_and_types

    kind, value = MESSAGES["action"]
    topic = "/team/agent_3/action"
    tokens = [session.liveliness().declare_token(kept("token", name)) for name in ("node", "publisher")]
    # Before anybody reads it: what is listed is what the tokens say.
    listed = wait_for("the topic", lambda: get_topic_names_and_types(domain_id=7, router_port=port))
    assert listed == [(topic, [kind])], listed
    info = get_topic_info(topic, domain_id=7, router_port=port)
    assert (info.publisher_count, info.subscriber_count) == (1, 0), info

    heard = []
    own = {"msg_definition": OWN_TEXTS[kind], "type_hash": kept("hash", kind)}
    reader = ROS2Subscriber(topic, kind, heard.append, domain_id=7, router_port=port, **own)
    payload, attachment = bytes.fromhex(kept("message", "action")), bytes.fromhex(kept("attachment", "publisher"))

    def put():
        session.put(kept("key", "action"), payload, attachment=attachment)
        return heard

    action = wait_for("the action", put)[0]
    assert action.header.frame_id == value["header"]["frame_id"]
    assert vars(action.header.stamp).items() >= value["header"]["stamp"].items()
    fields = {name: getattr(action, name) for name in value if name != "header"}
    assert fields == {name: part for name, part in value.items() if name != "header"}, fields
    reader.close()
    for token in tokens:
        token.undeclare()


def to_the_crate(session, client, port):
    from zenoh_ros2_sdk import ROS2Publisher

    kind, value = MESSAGES["array"]
    heard = []
    key = f"0/team/observation/std_msgs::msg::dds_::Float32MultiArray_/{kept('hash', kind)}"
    subscriber = session.declare_subscriber(key, heard.append)
    own = {"msg_definition": plain(kind), "type_hash": kept("hash", kind)}
    writer = ROS2Publisher("/team/observation", kind, domain_id=0, router_port=port, **own)
    types = client.store.types
    dims = [types["std_msgs/msg/MultiArrayDimension"](**dim) for dim in value["layout"]["dim"]]
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=dims, data_offset=0)

    def publish():
        writer.publish(layout=layout, data=numpy.array(value["data"], dtype="float32"))
        return heard

    sample = wait_for("the observation", publish)[0]
    assert sample.payload.to_bytes().hex() == kept("message", "array")
    assert len(sample.attachment.to_bytes()) == 33
    writer.close()
    subscriber.undeclare()


def main():
    os.environ["ZENOH_CONFIG_OVERRIDE"] = ";".join(f"{key}={value}" for key, value in ALONE.items())
    from zenoh_ros2_sdk.session import ZenohSession

    port = free_port()
    session = open_plain(port)
    client = ZenohSession.get_instance("127.0.0.1", port)
    for kind in PARTS:
        client.register_message_type(plain(kind), kind)
    from_the_crate(session, port)
    to_the_crate(session, client, port)
    client.session.close()
    session.close()
    print("an action went over zenoh and was read as it was, an observation came back as the crate reads it")


if __name__ == "__main__":
    main()
