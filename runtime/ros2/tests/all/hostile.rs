//! Bytes and texts that are cut, changed and made to hurt: each is read or refused, and nothing else happens.

use std::fmt::Debug;

use sortie_ros2::messages::{
    Action, Allocation, Float32MultiArray, Int32, JointState, Message, Observation, Text,
};
use sortie_ros2::{
    Attachment, AttachmentError, CdrError, Definition, DefinitionError, Kind, NameError, Node, Qos,
    QosError, Release, Token, TokenError, TypeHash, TypeName, decode, encode,
};

use crate::{bytes_of, golden, independent, samples};

/// A generator of numbers that are the same everywhere.
struct Drawn(u64);

impl Drawn {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() % count as u64) as usize
    }
}

/// What is read of changed bytes is written as bytes that are read as the same.
fn survives<M: Message + Debug>(message: &M) {
    let mut bytes = Vec::new();
    encode(message, &mut bytes).unwrap();
    // A cut at every byte is refused; where a whole header is left, for being short.
    for end in 0..bytes.len() {
        let error = decode::<M>(&bytes[..end]).unwrap_err();
        let wanted = if end < 4 { CdrError::NoHeader(end) } else { CdrError::Short(M::NAME) };
        assert_eq!(error, wanted, "{} cut after {end}", M::NAME);
    }
    let mut again = Vec::new();
    let mut try_reading = |bytes: &[u8]| {
        let Ok(read) = decode::<M>(bytes) else { return };
        encode(&read, &mut again).unwrap();
        // NaN is not NaN, so bytes are compared.
        let mut third = Vec::new();
        encode(&decode::<M>(&again).unwrap(), &mut third).unwrap();
        assert_eq!(again, third);
    };
    for bit in 0..bytes.len() * 8 {
        let mut changed = bytes.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        try_reading(&changed);
    }
    // Every place as the largest count, which no memory would hold.
    for at in 4..bytes.len().saturating_sub(3) {
        let mut changed = bytes.clone();
        changed[at..at + 4].fill(0xFF);
        try_reading(&changed);
    }
    let mut drawn = Drawn(0x5EED);
    for _ in 0..2_000 {
        let mut changed = bytes.clone();
        for _ in 0..=drawn.below(4) {
            let at = drawn.below(changed.len());
            changed[at] = drawn.next() as u8;
        }
        changed.truncate(1 + drawn.below(changed.len()));
        try_reading(&changed);
    }
    // Up to three bytes behind it are padding, the fourth is another message.
    for padding in 1..4 {
        bytes.push(0);
        assert!(decode::<M>(&bytes).is_ok(), "{} with {padding} behind", M::NAME);
    }
    bytes.push(0);
    assert_eq!(decode::<M>(&bytes).unwrap_err(), CdrError::Long { name: M::NAME, left: 4 });
}

#[test]
fn messages() {
    survives(&samples::text("größer"));
    survives(&samples::choice());
    survives(&samples::array());
    survives(&samples::joints());
    survives(&samples::joints_moving());
    survives(&samples::observation());
    survives(&samples::action());
    survives(&samples::allocation());
}

#[test]
fn noise_is_no_message() {
    let mut drawn = Drawn(7);
    for length in 0..200 {
        let mut bytes: Vec<u8> = (0..length).map(|_| drawn.next() as u8).collect();
        if let Some(header) = bytes.first_chunk_mut::<4>() {
            *header = [0, 1, 0, 0];
        }
        let _ = decode::<Text>(&bytes);
        let _ = decode::<Int32>(&bytes);
        let _ = decode::<Float32MultiArray>(&bytes);
        let _ = decode::<JointState>(&bytes);
        let _ = decode::<Observation>(&bytes);
        let _ = decode::<Action>(&bytes);
        let _ = decode::<Allocation>(&bytes);
    }
}

#[test]
fn other_encodings_are_refused_by_name() {
    let with = |high, low| decode::<Text>(&[high, low, 0, 0, 1, 0, 0, 0, 0]).unwrap_err();
    assert_eq!(with(0, 0), CdrError::BigEndian);
    assert_eq!(with(0, 3), CdrError::Encoding(3));
    assert_eq!(with(0, 7).to_string(), "its encoding is 0x0007, not plain CDR (0x0001)");
    let no_text = [0, 1, 0, 0, 3, 0, 0, 0, 0xFF, 0xFE, 0];
    assert!(matches!(decode::<Text>(&no_text), Err(CdrError::Content { .. })));
}

#[test]
fn attachments() {
    let captured = bytes_of(&golden("attachment-real-humble.hex")[0]);
    for end in 0..captured.len() {
        assert_eq!(Attachment::from_bytes(&captured[..end]), Err(AttachmentError::Length(end)));
    }
    let longer = [captured.as_slice(), &[0]].concat();
    assert_eq!(Attachment::from_bytes(&longer), Err(AttachmentError::Length(34)));
    for bit in 0..captured.len() * 8 {
        let mut changed = captured.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        match Attachment::from_bytes(&changed) {
            Ok(read) => assert_eq!(read.to_bytes().as_slice(), changed, "bit {bit}"),
            Err(error) => assert_eq!(error, AttachmentError::Gid(changed[16]), "bit {bit}"),
        }
    }
}

fn tokens() -> Vec<String> {
    let captured = golden("liveliness-token-real-humble.txt")[0].clone();
    let own = ["node", "publisher", "subscription"].map(|name| independent("token", name));
    std::iter::once(captured).chain(own).collect()
}

#[test]
fn tokens_that_are_cut_or_changed() {
    let mut drawn = Drawn(11);
    let letters: Vec<char> = "/%:,_+-@*$?#aZ09ß\0".chars().collect();
    for token in tokens() {
        let count = token.split('/').count();
        for end in 0..token.len() {
            let cut = &token[..end];
            if let Ok(read) = Token::parse(cut) {
                // Only the end of the last part may be missing.
                assert_eq!(cut.split('/').count(), count, "{cut}");
                assert_eq!(read.to_string(), cut);
            }
        }
        for _ in 0..20_000 {
            let mut changed: Vec<char> = token.chars().collect();
            for _ in 0..=drawn.below(3) {
                let (at, letter) =
                    (drawn.below(changed.len()), letters[drawn.below(letters.len())]);
                match drawn.below(3) {
                    0 => changed[at] = letter,
                    1 => changed.insert(at, letter),
                    _ => drop(changed.remove(at)),
                }
            }
            let changed: String = changed.into_iter().collect();
            if let Ok(read) = Token::parse(&changed) {
                assert_eq!(Token::parse(&read.to_string()).as_ref(), Ok(&read), "{changed}");
            }
        }
    }
}

#[test]
fn tokens_are_refused_by_what_is_wrong() {
    let token = &tokens()[0];
    let with = |from: &str, to: &str| {
        assert!(token.contains(from), "{from}");
        Token::parse(&token.replacen(from, to, 1)).unwrap_err()
    };
    assert_eq!(with("@ros2_lv", "ros2_lv"), TokenError::Part("space"));
    assert_eq!(with("/0/9ca0", "/-1/9ca0"), TokenError::Part("domain"));
    assert_eq!(with("/0/9ca0", "/+1/9ca0"), TokenError::Part("domain"));
    assert_eq!(with("/3/MP", "/x/MP"), TokenError::Part("number"));
    assert_eq!(with("MP", "MX"), TokenError::Part("kind"));
    assert_eq!(with("MP", "NN"), TokenError::Part("end"));
    assert_eq!(with("9ca0f", "9CA0f").to_string().split(' ').nth(1), Some("is"));
    assert_eq!(with("%chatter", "chatter"), NameError::Topic("chatter".to_owned()).into());
    let no_type = NameError::Type("std_msgs::String_".to_owned());
    assert_eq!(with("std_msgs::msg::dds_::", "std_msgs::"), no_type.into());
    assert_eq!(with("TypeHash", "RIHS01_"), TokenError::Part("hash"));
    assert_eq!(with(":1:,1", ":7:,1"), QosError("durability").into());
    assert_eq!(with(":1:,1:,:,:,,", ":1:,1:,:"), QosError("liveliness").into());
    assert_eq!(Token::parse(&"@".repeat(5000)), Err(TokenError::Long(5000)));
}

#[test]
fn qualities_of_service_are_read_as_they_are_written() {
    for text in ["::,:,:,:,,", "2::,5:,:,:,,", "4:1:2,0:1,2:3,4:3,5,6", ":1:,1:,:,:,,"] {
        assert_eq!(Qos::parse(text).unwrap().to_string(), text);
        for end in 0..text.len() {
            let _ = Qos::parse(&text[..end]);
        }
    }
    assert_eq!(Qos::TOPIC.to_string(), "::,10:,:,:,,");
    assert_eq!(Qos::SENSOR.to_string(), "2::,5:,:,:,,");
    for (text, wrong) in [
        ("3::,:,:,:,,", "reliability"),
        ("::4,:,:,:,,", "history"),
        ("::,-1:,:,:,,", "depth"),
        ("::,+1:,:,:,,", "depth"),
        ("::,99999999999999999999:,:,:,,", "depth"),
        ("::,:,:,:4,,", "liveliness"),
        ("::,:,:,:", "liveliness"),
    ] {
        assert_eq!(Qos::parse(text), Err(QosError(wrong)), "{text}");
    }
}

#[test]
fn names_that_would_mean_something_to_zenoh_are_refused() {
    for topic in ["", "a//b", "a/", "*", "a/**", "a$*", "a?b", "a#", "1a", "a/1", "ä", "a b", "a%b"]
    {
        let node = Node::new(0, "1", "/team", "bridge", Release::Humble).unwrap();
        let error = node.publisher::<Text>(1, topic, Qos::TOPIC).unwrap_err();
        let name = NameError::Topic(format!("/team/{topic}"));
        assert_eq!(error, DefinitionError::Name(name), "{topic}");
    }
    let refused = |session, namespace, name| {
        Node::new(0, session, namespace, name, Release::Humble).unwrap_err()
    };
    assert_eq!(refused("", "/", "a"), NameError::Session(String::new()));
    assert_eq!(refused("0x1", "/", "a"), NameError::Session("0x1".to_owned()));
    assert_eq!(refused("1", "team", "a"), NameError::Namespace("team".to_owned()));
    assert_eq!(refused("1", "/team/", "a"), NameError::Namespace("/team/".to_owned()));
    assert_eq!(refused("1", "/", "a/b"), NameError::Node("a/b".to_owned()));
    for name in ["String", "std_msgs/String", "std_msgs/msg/", "std_msgs/idl/String", "a/msg/b/c"] {
        assert_eq!(TypeName::new(name), Err(NameError::Type(name.to_owned())));
    }
    for dds in ["", "std_msgs::msg::String_", "std_msgs::msg::dds_::String", "a::b::dds_::C_"] {
        assert_eq!(TypeName::of_dds(dds), Err(NameError::Type(dds.to_owned())));
    }
    assert_eq!(Kind::Client.letters(), "SC");
}

#[test]
fn hashes_that_are_none_are_refused() {
    let hash = independent("hash", "std_msgs/msg/String");
    for end in 0..hash.len() {
        assert_eq!(TypeHash::parse(&hash[..end]), None);
    }
    assert_eq!(TypeHash::parse(&format!("{hash}0")), None);
    assert_eq!(TypeHash::parse(&hash.to_uppercase()), None);
    assert_eq!(TypeHash::parse(&hash.replace('f', "g")), None);
}

#[test]
fn definitions_are_refused_by_line() {
    let name = || TypeName::new("demo_msgs/msg/Pose").unwrap();
    let line = |line, text: &str| DefinitionError::Line { name: name(), line, text: text.into() };
    let field = |line, text: &str| DefinitionError::Field { name: name(), line, text: text.into() };
    for (text, wanted) in [
        ("", DefinitionError::Empty(name())),
        ("# nothing\nuint8 A=1\n", DefinitionError::Empty(name())),
        ("uint8", line(1, "uint8")),
        ("uint8 a\nuint8 1b", line(2, "uint8 1b")),
        ("uint8 a-b=3", line(1, "uint8 a-b=3")),
        ("uint9 a", field(1, "uint9")),
        ("uint8[0] a", field(1, "uint8[0]")),
        ("uint8[-1] a", field(1, "uint8[-1]")),
        ("uint8] a", field(1, "uint8]")),
        ("uint8<=3 a", field(1, "uint8<=3")),
        ("a/b/C c", field(1, "a/b/C")),
    ] {
        assert_eq!(Definition::parse(name(), text), Err(wanted), "{text}");
    }
    let hash = |find: &dyn Fn(&str) -> Option<&'static str>| TypeHash::compute(&name(), find);
    assert_eq!(hash(&|_| None), Err(DefinitionError::Unknown(name())));
    assert_eq!(hash(&|_| Some("Pose inner")), Err(DefinitionError::Deep(name())));
    // Two that are part of each other.
    let each_other = |of: &str| Some(if of.ends_with("Pose") { "Twist t" } else { "Pose p" });
    assert!(matches!(hash(&each_other), Err(DefinitionError::Deep(_))));
}

#[test]
fn definitions_that_are_changed() {
    let mut drawn = Drawn(3);
    let letters: Vec<char> = "[]<>=# /09azA_\n\t".chars().collect();
    for (name, text) in sortie_ros2::messages::DEFINITIONS {
        for _ in 0..2_000 {
            let mut changed: Vec<char> = text.chars().collect();
            for _ in 0..=drawn.below(4) {
                let at = drawn.below(changed.len());
                changed[at] = letters[drawn.below(letters.len())];
            }
            let changed: String = changed.into_iter().collect();
            let _ = Definition::parse(TypeName::new(name).unwrap(), &changed);
        }
    }
}
