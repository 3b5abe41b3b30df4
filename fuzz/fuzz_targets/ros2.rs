//! What comes from ROS: messages, attachments, tokens, hashes and definitions are read or refused with a reason, never a panic; what was
//! read is written as it was.
#![no_main]

use libfuzzer_sys::fuzz_target;
use sortie_ros2::messages::{Float32MultiArray, Int32, JointState, Message, Observation, Text};
use sortie_ros2::{Attachment, Definition, Qos, Token, TypeHash, TypeName, decode, encode};

const DEFINED: &str = "std_msgs/msg/Any";

/// What was read comes out again as bytes that say the same.
fn message<M: Message>(bytes: &[u8]) {
    match decode::<M>(bytes) {
        Ok(message) => {
            let (mut once, mut twice) = (Vec::new(), Vec::new());
            encode(&message, &mut once).unwrap();
            encode(&decode::<M>(&once).unwrap(), &mut twice).unwrap();
            assert_eq!(once, twice);
        }
        Err(refusal) => assert!(!refusal.to_string().is_empty()),
    }
}

fn text(text: &str) {
    if let Ok(token) = Token::parse(text) {
        assert_eq!(Token::parse(&token.to_string()).unwrap(), token);
    }
    let _ = (Qos::parse(text), TypeHash::parse(text), TypeName::of_dds(text));
    let name = TypeName::new(DEFINED).unwrap();
    let hash = TypeHash::compute(&name, &|name| (name == DEFINED).then_some(text));
    assert!(hash.is_err() || Definition::parse(name, text).is_ok());
}

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, rest)) = bytes.split_first() else { return };
    match kind % 7 {
        0 => message::<Float32MultiArray>(rest),
        1 => message::<JointState>(rest),
        2 => message::<Observation>(rest),
        3 => message::<Int32>(rest),
        4 => message::<Text>(rest),
        5 => {
            let _ = Attachment::from_bytes(rest);
        }
        _ => {
            if let Ok(words) = std::str::from_utf8(rest) {
                text(words);
            }
        }
    }
});
