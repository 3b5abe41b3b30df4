#!/usr/bin/env python3
"""What others make of the same messages, keys and tokens, kept for the Rust tests.

    python3 -m venv target/venv
    target/venv/bin/pip install rosbags==0.11.9 rosless==0.5.0 zenoh-ros2-sdk==0.1.8 xxhash==4.1.0
    target/venv/bin/python runtime/ros2/tests/independent.py            # compares with tests/golden/ros2/independent.txt
    target/venv/bin/python runtime/ros2/tests/independent.py --write    # writes it

Nothing here calls the crate: bytes are those of `rosbags` and, for ROS's own messages, of `rosless` (two other writers, which
have to agree, and read each other's); hashes those of `rosbags` and `zenoh-ros2-sdk`; keys, tokens and attachments those of
`zenoh-ros2-sdk`; ids of publishers those of the `xxhash` package. Values are those of tests/all/samples.rs.
"""

import sys
from pathlib import Path

import numpy
import rosless
import xxhash
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr, topic_keyexpr
from zenoh_ros2_sdk.utils import get_type_hash, ros2_to_dds_type

ROOT = Path(__file__).resolve().parents[3]
KEPT = ROOT / "tests/golden/ros2/independent.txt"
OWN = ["Observation", "Action", "Allocation"]

STORE = get_typestore(Stores.ROS2_JAZZY)
# All that a definition may hold, for the hash; but `char`, of which both have another number than ROS.
EVERY = (ROOT / "tests/golden/ros2/Every.msg").read_text()
STORE.register(get_types_from_msg(EVERY, "demo_msgs/msg/Every"))
OWN_TEXTS = {
    f"sortie_msgs/msg/{name}": (ROOT / f"runtime/ros2/sortie_msgs/msg/{name}.msg").read_text() for name in OWN
}
for own, text in OWN_TEXTS.items():
    STORE.register(get_types_from_msg(text, own))


def stamp(frame_id):
    return {"stamp": {"sec": 1700000000, "nanosec": 123456789}, "frame_id": frame_id}


# Odd lengths of texts and lists, so that what follows is not aligned by chance.
MESSAGES = {
    "text": ("std_msgs/msg/String", {"data": "hello"}),
    "text-empty": ("std_msgs/msg/String", {"data": ""}),
    "text-umlaut": ("std_msgs/msg/String", {"data": "größer"}),
    "choice": ("std_msgs/msg/Int32", {"data": -7}),
    "array": (
        "std_msgs/msg/Float32MultiArray",
        {
            "layout": {
                "dim": [{"label": "force", "size": 3, "stride": 3}],
                "data_offset": 0,
            },
            "data": [0.25, -1.5, 3.0e38],
        },
    ),
    "array-plain": (
        "std_msgs/msg/Float32MultiArray",
        {"layout": {"dim": [], "data_offset": 0}, "data": []},
    ),
    "joints": (
        "sensor_msgs/msg/JointState",
        {
            "header": stamp(""),
            "name": ["hip", "knee_l"],
            "position": [0.5, -0.125],
            "velocity": [],
            "effort": [],
        },
    ),
    "joints-moving": (
        "sensor_msgs/msg/JointState",
        {
            "header": stamp("base"),
            "name": ["hip"],
            "position": [0.5],
            "velocity": [-1.0],
            "effort": [2.5],
        },
    ),
    "observation": (
        "sortie_msgs/msg/Observation",
        {
            "header": stamp("agent_3"),
            "tick": 1 << 32 | 7,
            "episode": 9,
            "step": 4,
            "agent": 3,
            "flags": 3,
            "entities": [3, 0, 8],
            "features": 2,
            "rows": [0.5, 1.0, -2.0, 0.0, 3.25, 1e-3],
            "last_actions": [2, 65535, 65535],
            "tasks": [1, 0, 1 << 31],
            "open_tasks": 5,
            "available": [1, 0, 1, 4, 0],
        },
    ),
    "action": (
        "sortie_msgs/msg/Action",
        {
            "header": stamp("agent_3"),
            "tick": 1 << 32 | 7,
            "agent": 3,
            "action": 2,
            "task": 255,
            "flags": 40,
            "utility": 7.125,
            "decide_ns": 1900,
            "alloc_term": 1,
            "alloc_epoch": 17,
            "runner": 4711,
        },
    ),
    "allocation": (
        "sortie_msgs/msg/Allocation",
        {
            "header": stamp(""),
            "tick": 1 << 32 | 5,
            "valid_until": 1 << 32 | 14,
            "term": 1,
            "epoch": 17,
            "flags": 1,
            "tasks": [0, 4, 255, 1, 2],
        },
    ),
}


def built(kind, value):
    """A value as rosbags wants it: an object of the type, numbers as arrays."""
    return STORE.types[kind](**{name: part(of, value[name]) for name, of in STORE.fielddefs[kind][1]})


def part(of, value):
    node, detail = int(of[0]), of[1]
    if node == 1:
        return value
    if node == 2:
        return built(detail, value)
    element_node, element = int(detail[0][0]), detail[0][1]
    if element_node == 2:
        return [built(element, one) for one in value]
    base = element[0]
    if base == "string":
        return list(value)
    return numpy.array(value, dtype=base)


def encoded(name):
    kind, value = MESSAGES[name]
    ours = bytes(STORE.serialize_cdr(built(kind, value), kind, little_endian=True))
    if not kind.startswith("sortie_msgs"):
        theirs = rosless.encode(kind, value)
        assert theirs == ours, f"{name}: the two writers differ:\n{theirs.hex()}\n{ours.hex()}"
        # It reads an empty list of doubles as if one followed, eight bytes aligned, though it writes none: so do neither
        # Fast-CDR nor rosbags.
        if name != "joints":
            read = rosless.decode(kind, ours).to_dict()
            assert rosless.encode(kind, read) == ours, f"{name}: it is read as {read}"
    again = STORE.deserialize_cdr(ours, kind)
    assert bytes(STORE.serialize_cdr(again, kind, little_endian=True)) == ours, name
    return ours.hex()


def parts_of(kind, found):
    """All definitions that a type consists of, but for itself, as texts without comments."""
    for field in STORE.fielddefs[kind][1]:
        of = field[1]
        while int(of[0]) > 2:
            of = of[1][0]
        if int(of[0]) == 2 and of[1] not in found:
            found[of[1]] = plain(of[1])
            parts_of(of[1], found)
    return found


def plain(kind):
    text, _ = STORE.generate_msgdef(kind, ros_version=2)
    return "\n".join(text.split("=" * 80)[0].splitlines())


def hashed(kind):
    ours = STORE.hash_rihs01(kind)
    text = OWN_TEXTS.get(kind) or plain(kind)
    theirs = get_type_hash(kind, msg_definition=text, dependencies=parts_of(kind, {}))
    assert theirs == ours, f"{kind}: {theirs} by zenoh-ros2-sdk, {ours} by rosbags"
    return ours


def lines():
    for name in MESSAGES:
        yield f"message {name} {encoded(name)}"
    parts = {"builtin_interfaces/msg/Time", "std_msgs/msg/Empty", "std_msgs/msg/Header"}
    kinds = sorted({kind for kind, _ in MESSAGES.values()} | parts)
    hashes = {kind: hashed(kind) for kind in kinds}
    yield from (f"hash {kind} {hashes[kind]}" for kind in kinds)

    yield f"hash demo_msgs/msg/Every {STORE.hash_rihs01('demo_msgs/msg/Every')}"

    node = NodeEntity(7, "9ca0f8facf84ffb1e6bfa4f2500889f0", 0, "sortie_bridge", "/team")
    yield f"token node {node_liveliness_keyexpr(node)}"
    kind = "sortie_msgs/msg/Action"
    topic = "/team/agent_3/action"
    dds, type_hash = ros2_to_dds_type(kind), hashes[kind]
    yield f"key action {topic_keyexpr(7, topic, dds, type_hash)}"
    for name, entity_kind in (("publisher", EntityKind.PUBLISHER), ("subscription", EntityKind.SUBSCRIPTION)):
        # The SDK takes ten for what rmw_zenoh leaves out; that is 42 there.
        end = EndpointEntity(node, 9, entity_kind, topic, dds, type_hash, "::,10:,:,:,,")
        token = endpoint_liveliness_keyexpr(end)
        yield f"token {name} {token}"
        gid = xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")
        yield f"gid {name} {gid.hex()}"
        yield f"attachment {name} {Attachment(216, 1700000000123456789, gid).to_bytes().hex()}"


def main():
    text = "".join(f"{line}\n" for line in lines())
    if "--write" in sys.argv:
        KEPT.write_text(text)
    elif KEPT.read_text() != text:
        sys.exit(f"{KEPT} is not what they make of it now:\n{text}")
    print(f"{len(text.splitlines())} lines of {KEPT.relative_to(ROOT)} are as they make them")


if __name__ == "__main__":
    main()
