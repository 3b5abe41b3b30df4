//! Bit for bit: what a real publisher sent (ROS 2 Humble, rmw_zenoh_cpp 0.1.8), and what other programs write.

use std::fmt::Debug;

use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader};
use sortie_core::{NO_ACTION, UNASSIGNED};
use sortie_ros2::messages::{
    Action, Allocation, DEFINITIONS, Empty, Float32MultiArray, Int32, JointState, Message,
    Observation, Text,
};
use sortie_ros2::{
    Attachment, Definition, Durability, Kind, Node, Qos, Release, Token, TypeHash, TypeName,
    decode, encode,
};

use crate::samples::{self, SOURCE_NS};
use crate::{bytes_of, golden, hex, independent};

#[test]
fn the_captured_attachment_is_read_and_written() {
    let captured = bytes_of(&golden("attachment-real-humble.hex")[0]);
    let attachment = Attachment::from_bytes(&captured).unwrap();
    assert_eq!(attachment.sequence, 216);
    assert_eq!(attachment.source_ns, 1_784_824_452_167_621_172);
    assert_eq!(hex(&attachment.to_bytes()), hex(&captured));
}

#[test]
fn the_captured_token_is_read_and_written() {
    let captured = &golden("liveliness-token-real-humble.txt")[0];
    let token = Token::parse(captured).unwrap();
    assert_eq!((token.domain, token.node, token.entity, token.kind), (0, 0, 3, Kind::Publisher));
    assert_eq!((token.namespace.as_str(), token.name.as_str()), ("/", "_ros2cli_712"));
    let topic = token.topic.as_ref().unwrap();
    assert_eq!((topic.name.as_str(), topic.type_name.as_str()), ("/chatter", Text::NAME));
    let qos = Qos { durability: Durability::TransientLocal, depth: 1, ..Qos::TOPIC };
    assert_eq!((topic.hash, topic.qos), (TypeHash::NotSupported, qos));
    assert_eq!(token.to_string(), *captured);
}

/// Both were captured of one publisher: its id is made of its token.
#[test]
fn the_captured_attachment_has_the_id_of_the_captured_token() {
    let token = Token::parse(&golden("liveliness-token-real-humble.txt")[0]).unwrap();
    let captured = bytes_of(&golden("attachment-real-humble.hex")[0]);
    assert_eq!(token.gid(), Attachment::from_bytes(&captured).unwrap().gid);
}

#[test]
fn keys_of_data_are_the_captured_ones() {
    let key = |domain, namespace, topic| {
        let node = Node::new(domain, "9ca0", namespace, "talker", Release::Humble).unwrap();
        node.publisher::<Text>(3, topic, Qos::TOPIC).unwrap().key().to_owned()
    };
    let keys = [key(0, "/", "chatter"), key(42, "/robot", "_hidden/chatter")];
    assert_eq!(golden("data-keys.txt"), keys);
}

#[test]
fn keys_tokens_and_ids_are_those_of_another_program() {
    let session = "9ca0f8facf84ffb1e6bfa4f2500889f0";
    let node = Node::new(7, session, "/team", "sortie_bridge", Release::Jazzy).unwrap();
    assert_eq!(node.token().to_string(), independent("token", "node"));
    let publisher = node.publisher::<Action>(9, "agent_3/action", Qos::TOPIC).unwrap();
    assert_eq!(publisher.key(), independent("key", "action"));
    let (subscription, key) = node.subscription::<Action>(9, "agent_3/action", Qos::TOPIC).unwrap();
    assert_eq!(key, independent("key", "action"));
    for (name, token) in [("publisher", publisher.token()), ("subscription", &subscription)] {
        assert_eq!(token.to_string(), independent("token", name));
        assert_eq!(hex(&token.gid()), independent("gid", name));
        let attachment =
            Attachment { sequence: 216, source_ns: SOURCE_NS as i64, gid: token.gid() };
        assert_eq!(hex(&attachment.to_bytes()), independent("attachment", name));
        assert_eq!(Token::parse(&token.to_string()).unwrap(), *token);
    }
}

fn is_as_others_write<M: Message + PartialEq + Debug>(name: &str, message: M) {
    let mut bytes = vec![7; 99];
    encode(&message, &mut bytes).unwrap();
    assert_eq!(hex(&bytes), independent("message", name), "{name}");
    assert_eq!(decode::<M>(&bytes).unwrap(), message, "{name}");
}

#[test]
fn messages_are_the_bytes_that_other_programs_write() {
    is_as_others_write("text", samples::text("hello"));
    is_as_others_write("text-empty", samples::text(""));
    is_as_others_write("text-umlaut", samples::text("größer"));
    is_as_others_write("choice", samples::choice());
    is_as_others_write("array", samples::array());
    is_as_others_write("array-plain", Float32MultiArray::default());
    is_as_others_write("joints", samples::joints());
    is_as_others_write("joints-moving", samples::joints_moving());
    is_as_others_write("observation", samples::observation());
    is_as_others_write("action", samples::action());
    is_as_others_write("allocation", samples::allocation());
}

fn hash_of<M: Message>() -> (&'static str, String) {
    (M::NAME, Release::Jazzy.hash_of::<M>().unwrap().to_string())
}

#[test]
fn hashes_are_those_that_other_programs_compute() {
    let all = [
        hash_of::<Text>(),
        hash_of::<Int32>(),
        hash_of::<Empty>(),
        hash_of::<Float32MultiArray>(),
        hash_of::<JointState>(),
        hash_of::<Observation>(),
        hash_of::<Action>(),
        hash_of::<Allocation>(),
    ];
    for (name, hash) in all {
        assert_eq!(hash, independent("hash", name), "{name}");
        assert_eq!(TypeHash::parse(&hash).unwrap().to_string(), hash);
    }
}

/// As installations of ROS 2 print them (`ros2 topic info --verbose`, and rmw_zenoh's own page on its keys).
#[test]
fn hashes_are_those_that_ros_publishes() {
    let published = [
        (Text::NAME, "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
        (
            JointState::NAME,
            "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
        ),
        (
            "std_msgs/msg/MultiArrayLayout",
            "RIHS01_4c66e6f78e740ac103a94cf63259f968e48c617e7699e829b63c21a5cb50dac6",
        ),
        // A character is a byte there, whatever other readers of definitions take it for.
        (
            "std_msgs/msg/Char",
            "RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
        ),
    ];
    let find = |wanted: &str| match wanted {
        "std_msgs/msg/Char" => Some("char data"),
        other => sortie_ros2::messages::definition(other),
    };
    for (name, hash) in published {
        let computed = TypeHash::compute(&TypeName::new(name).unwrap(), &find).unwrap();
        assert_eq!(computed.to_string(), hash, "{name}");
    }
}

/// Every primitive, arrays, bounds, defaults and constants, which no message of this crate has all of.
#[test]
fn the_hash_of_all_that_a_definition_may_hold_is_that_of_another_program() {
    let name = TypeName::new("demo_msgs/msg/Every").unwrap();
    let text = golden("Every.msg").join("\n");
    let find = |wanted: &str| match wanted {
        "demo_msgs/msg/Every" => Some(text.as_str()),
        other => sortie_ros2::messages::definition(other),
    };
    let hash = TypeHash::compute(&name, &find).unwrap();
    assert_eq!(hash.to_string(), independent("hash", name.as_str()));
}

#[test]
fn comments_constants_and_defaults_do_not_count() {
    let name = TypeName::new("demo_msgs/msg/Pose").unwrap();
    let hash = |text: &'static str| TypeHash::compute(&name, &|_| Some(text)).unwrap();
    let plain = hash("float64[3] at\nstring<=8 name\nuint8[<=4] tags\n");
    assert_eq!(
        plain,
        hash(
            "# a pose\nuint8 LOST=1\nfloat64[3] at\nstring<=8 name \"x\" # its name\n\nuint8[<=4] tags\n"
        )
    );
    let others = [
        "float64[] at\nstring<=8 name\nuint8[<=4] tags\n",
        "float64[4] at\nstring<=8 name\nuint8[<=4] tags\n",
        "float64[3] at\nstring name\nuint8[<=4] tags\n",
        "float64[3] at\nstring<=8 name\nuint8[4] tags\n",
        "float64[3] at\nuint8[<=4] tags\nstring<=8 name\n",
    ];
    for other in others {
        assert_ne!(plain, hash(other), "{other}");
    }
}

#[test]
fn constants_of_the_definitions_are_those_of_the_wire() {
    let numbers = |kind: &str| {
        let (name, text) = DEFINITIONS.iter().find(|(name, _)| name.ends_with(kind)).unwrap();
        let definition = Definition::parse(TypeName::new(name).unwrap(), text).unwrap();
        let number = |(name, value): &(String, String)| (name.clone(), value.parse().unwrap());
        definition.constants.iter().map(number).collect::<Vec<(String, u32)>>()
    };
    let named = |all: &[(&str, u32)]| {
        all.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect::<Vec<_>>()
    };
    let observation = [
        ("EPISODE_START", FrameHeader::EPISODE_START),
        ("REALLOC", FrameHeader::REALLOC),
        ("EPISODE_END", FrameHeader::EPISODE_END),
        ("PAUSED", FrameHeader::PAUSED),
        ("SHUTDOWN", FrameHeader::SHUTDOWN),
        ("NO_ACTION", NO_ACTION),
    ];
    let action = [
        ("STALE_ALLOC", ActionMsg::STALE_ALLOC),
        ("NO_ALLOC", ActionMsg::NO_ALLOC),
        ("EXPLORE", ActionMsg::EXPLORE),
        ("LATE", ActionMsg::LATE),
        ("FALLBACK", ActionMsg::FALLBACK),
        ("TICK_GAP", ActionMsg::TICK_GAP),
        ("STATE_RESET", ActionMsg::STATE_RESET),
        ("GUARD", ActionMsg::GUARD),
        ("NO_ACTION", NO_ACTION),
        ("UNASSIGNED", u16::from(UNASSIGNED)),
    ];
    let allocation = [
        ("FIRST_OF_TERM", AllocMsg::FIRST_OF_TERM),
        ("PARTIAL", AllocMsg::PARTIAL),
        ("HEURISTIC", AllocMsg::HEURISTIC),
        ("UNASSIGNED", u32::from(UNASSIGNED)),
    ];
    assert_eq!(numbers("Observation"), named(&observation.map(|(name, of)| (name, of.into()))));
    assert_eq!(numbers("Action"), named(&action.map(|(name, of)| (name, of.into()))));
    assert_eq!(numbers("Allocation"), named(&allocation));
}
