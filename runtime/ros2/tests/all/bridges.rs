//! A team and a policy behind a carrier that keeps what it is given.

use std::collections::BTreeSet;

use sortie_core::plan::AlignedBytes;
use sortie_core::wire::{
    ABI, ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameKind, FrameLayout, FrameMut,
};
use sortie_core::{EntityMask, NO_ACTION, Shape, UNASSIGNED};
use sortie_ros2::messages::{
    Action, Allocation, Float32MultiArray, Int32, JointState, Message, Observation,
};
use sortie_ros2::{
    Answer, Attachment, BridgeError, Bridged, Carrier, CdrError, Kind, Node, ObservationError,
    PolicyFacts, PolicyNode, Release, TeamBridge, TeamFacts, Token, decode, encode,
};
use zerocopy::FromZeros;

use crate::samples;

const SHAPE: Shape = Shape { agents: 3, entities: 5, tasks: 2, actions: 4, features: 3 };
const SCHEMA: u64 = 0xC0FFEE;
const AHEAD_NS: u64 = 1_700_000_000_000_000_000;
const TICK: u64 = 1 << 32 | 20;

#[derive(Debug, thiserror::Error)]
#[error("closed")]
struct Closed;

struct Put {
    key: String,
    bytes: Vec<u8>,
    attachment: Attachment,
}

/// In place of a session of zenoh.
#[derive(Default)]
struct Kept {
    tokens: Vec<String>,
    puts: Vec<Put>,
    /// Keys that nobody reads.
    unread: BTreeSet<String>,
    is_closed: bool,
}

impl Carrier for Kept {
    type Error = Closed;

    fn declare(&mut self, token: &str) -> Result<(), Closed> {
        self.tokens.push(token.to_owned());
        if self.is_closed { Err(Closed) } else { Ok(()) }
    }

    fn put(&mut self, key: &str, bytes: &[u8], attachment: &[u8]) -> Result<(), Closed> {
        let attachment = Attachment::from_bytes(attachment).unwrap();
        self.puts.push(Put { key: key.to_owned(), bytes: bytes.to_vec(), attachment });
        if self.is_closed { Err(Closed) } else { Ok(()) }
    }

    fn is_read(&mut self, key: &str) -> bool {
        !self.unread.contains(key)
    }
}

impl Kept {
    /// What was put to a topic since the last call, by the topic's name in the team's namespace.
    fn take<M: Message>(&mut self, topic: &str) -> Vec<(Attachment, M)> {
        let start = format!("0/team/{topic}/");
        let (taken, left) = std::mem::take(&mut self.puts)
            .into_iter()
            .partition::<Vec<_>, _>(|put| put.key.starts_with(&start));
        self.puts = left;
        taken.iter().map(|put| (put.attachment, decode(&put.bytes).unwrap())).collect()
    }
}

fn node() -> Node {
    Node::new(0, "abc", "/team", "sortie", Release::Jazzy).unwrap()
}

fn format() -> FrameFormat {
    FrameFormat { schema: SCHEMA, layout: FrameLayout::new(SHAPE).unwrap() }
}

fn bridge(carrier: Kept) -> TeamBridge<Kept> {
    let facts = TeamFacts { format: format(), ahead_ns: AHEAD_NS };
    TeamBridge::open(carrier, &node(), facts).unwrap()
}

fn set(entities: &[usize]) -> EntityMask {
    let mut set = EntityMask::EMPTY;
    entities.iter().for_each(|entity| set.insert(*entity));
    set
}

/// Agents 0 and 2 are there, 1 is not; agent 0 sees itself, 2 and 4, agent 2 sees 0 and 3, not itself.
fn frame() -> (FrameHeader, AlignedBytes) {
    let layout = format().layout;
    let mut payload = AlignedBytes::zeroed(layout.payload_bytes());
    let mut frame = FrameMut::new(payload.as_mut_slice(), layout).unwrap();
    for entity in 0..SHAPE.entities {
        for (feature, to) in frame.row_mut(entity).iter_mut().enumerate() {
            *to = (10 * entity + feature) as f32;
        }
    }
    frame.set_present(&set(&[0, 2, 3, 4]));
    frame.set_observable(0, &set(&[0, 2, 4]));
    frame.set_observable(2, &set(&[0, 3]));
    frame.available_mut(0).copy_from_slice(&[1, 0, 2, 1]);
    frame.available_mut(2).copy_from_slice(&[1, 1, 1, 1]);
    frame.set_entity_task(2, 0b10);
    frame.set_entity_task(4, 0b01);
    frame.set_open_tasks(0b11);
    frame.set_last_action(2, 3);
    frame.set_progress(6, TICK - 1, 0b010);
    let header = FrameHeader {
        magic: FrameHeader::MAGIC,
        abi: ABI,
        kind: FrameKind::World as u16,
        schema: SCHEMA,
        seq: 1,
        tick: TICK,
        t_ns: 5_000_000_007,
        len: layout.payload_bytes() as u32,
        flags: FrameHeader::REALLOC,
        world_term: 1,
        episode: 9,
        ..FrameHeader::default()
    };
    (header, payload)
}

#[test]
fn a_team_says_that_it_is_there() {
    let mut bridge = bridge(Kept::default());
    let tokens: Vec<Token> =
        bridge.carrier().tokens.iter().map(|token| Token::parse(token).unwrap()).collect();
    assert_eq!(tokens[0], *node().token());
    let publishers: Vec<&str> = tokens[1..]
        .iter()
        .map(|token| {
            assert_eq!((token.kind, token.namespace.as_str()), (Kind::Publisher, "/team"));
            token.topic.as_ref().unwrap().name.as_str()
        })
        .collect();
    let agents = (0..3).flat_map(|agent| {
        ["observation", "action"].map(|topic| format!("/team/agent_{agent}/{topic}"))
    });
    let wanted: Vec<String> =
        std::iter::once("/team/allocation".to_owned()).chain(agents).collect();
    assert_eq!(publishers, wanted);
    let numbers: BTreeSet<u64> = tokens.iter().map(|token| token.entity).collect();
    assert_eq!(numbers.len(), tokens.len(), "no two have the same number");
}

#[test]
fn agents_observations_hold_what_they_see_and_nothing_else() {
    let mut bridge = bridge(Kept::default());
    let (header, payload) = frame();
    bridge.frame(&header, payload.as_slice()).unwrap();
    let first = bridge.carrier().take::<Observation>("agent_0/observation");
    let [(attachment, first)] = first.as_slice() else { panic!("{first:?}") };
    let stamp = samples::header("agent_0");
    assert_eq!(first.header.frame_id, stamp.frame_id);
    assert_eq!((first.header.stamp.sec, first.header.stamp.nanosec), (1_700_000_005, 7));
    assert_eq!((attachment.sequence, attachment.source_ns), (1, 1_700_000_005_000_000_007));
    assert_eq!((first.tick, first.episode, first.step, first.agent), (TICK, 9, 6, 0));
    assert_eq!((first.flags, first.open_tasks), (FrameHeader::REALLOC, 0b11));
    // The own row first, and once more because it sees itself.
    assert_eq!(first.entities, [0, 0, 2, 4]);
    assert_eq!(first.features, 3);
    assert_eq!(first.rows, [0., 1., 2., 0., 1., 2., 20., 21., 22., 40., 41., 42.]);
    assert_eq!(first.last_actions, [NO_ACTION, NO_ACTION, 3, NO_ACTION]);
    assert_eq!(first.tasks, [0, 0, 0b10, 0b01]);
    assert_eq!(first.available, [1, 0, 2, 1]);
    let third = bridge.carrier().take::<Observation>("agent_2/observation");
    assert_eq!(third[0].1.entities, [2, 0, 3]);
    // Agent 1 is not there.
    assert!(bridge.carrier().puts.is_empty());
    assert_eq!(bridge.bridged(), Bridged { observations: 2, ..Bridged::default() });
}

#[test]
fn numbers_of_messages_rise_by_one_and_name_their_publisher() {
    let mut bridge = bridge(Kept::default());
    let (header, payload) = frame();
    for _ in 0..3 {
        bridge.frame(&header, payload.as_slice()).unwrap();
    }
    let tokens = bridge.carrier().tokens.clone();
    let token = tokens.iter().find(|token| token.contains("%agent_2%observation")).unwrap();
    let gid = Token::parse(token).unwrap().gid();
    let taken = bridge.carrier().take::<Observation>("agent_2/observation");
    let attachments = taken.iter().map(|(attachment, _)| (attachment.sequence, attachment.gid));
    assert_eq!(attachments.collect::<Vec<_>>(), [(1, gid), (2, gid), (3, gid)]);
}

#[test]
fn frames_of_others_and_for_caches_are_not_passed_on() {
    let mut bridge = bridge(Kept::default());
    let (header, payload) = frame();
    let warm_up = FrameHeader { kind: FrameKind::WarmUp as u16, ..header };
    bridge.frame(&warm_up, payload.as_slice()).unwrap();
    assert_eq!(bridge.bridged(), Bridged::default());
    bridge.frame(&FrameHeader { schema: 1, ..header }, payload.as_slice()).unwrap();
    bridge.frame(&header, &payload.as_slice()[..64]).unwrap();
    assert_eq!(bridge.bridged(), Bridged { refused: 2, ..Bridged::default() });
    assert!(bridge.carrier().puts.is_empty());
}

fn answer(agent: u16) -> ActionMsg {
    ActionMsg {
        schema: SCHEMA,
        tick: TICK,
        t_ns: 123_456_789,
        alloc_epoch: 17,
        agent,
        action: 2,
        flags: ActionMsg::LATE,
        task: UNASSIGNED,
        abi: ABI as u8,
        q: 7.125,
        decide_ns: 1900,
        alloc_term: 1,
        runner: 4711,
        ..ActionMsg::new_zeroed()
    }
}

#[test]
fn actions_are_passed_on() {
    let mut bridge = bridge(Kept::default());
    bridge.action(&answer(2)).unwrap();
    let taken = bridge.carrier().take::<Action>("agent_2/action");
    let wanted = Action {
        header: samples::header("agent_2"),
        tick: TICK,
        agent: 2,
        flags: ActionMsg::LATE,
        ..samples::action()
    };
    assert_eq!(taken[0].1, wanted);
    // Who leaves its seat does not act; agent 3 does not exist; another domain is none of ours.
    bridge.action(&ActionMsg { flags: ActionMsg::BYE, ..answer(2) }).unwrap();
    bridge.action(&answer(3)).unwrap();
    bridge.action(&ActionMsg { schema: 1, ..answer(2) }).unwrap();
    assert!(bridge.carrier().puts.is_empty());
    assert_eq!(bridge.bridged(), Bridged { actions: 1, refused: 2, ..Bridged::default() });
}

#[test]
fn allocations_are_passed_on() {
    let mut bridge = bridge(Kept::default());
    let mut message = AllocMsg {
        schema: SCHEMA,
        tick: TICK,
        t_ns: 123_456_789,
        valid_until: TICK + 9,
        term: 1,
        epoch: 17,
        n_agents: 3,
        n_tasks: 2,
        abi: ABI as u8,
        flags: AllocMsg::FIRST_OF_TERM,
        ..AllocMsg::new_zeroed()
    };
    message.task = [UNASSIGNED; 64];
    message.task[..2].copy_from_slice(&[1, 0]);
    bridge.allocation(&message).unwrap();
    let taken = bridge.carrier().take::<Allocation>("allocation");
    let wanted = Allocation {
        tick: TICK,
        valid_until: TICK + 9,
        tasks: vec![1, 0, UNASSIGNED],
        ..samples::allocation()
    };
    assert_eq!(taken[0].1, wanted);
    message.task[2] = 2;
    bridge.allocation(&message).unwrap();
    assert_eq!(bridge.bridged(), Bridged { allocations: 1, refused: 1, ..Bridged::default() });
}

#[test]
fn what_nobody_reads_is_not_written() {
    let mut open = bridge(Kept::default());
    let (header, payload) = frame();
    open.frame(&header, payload.as_slice()).unwrap();
    let keys: BTreeSet<String> = open.carrier().puts.iter().map(|put| put.key.clone()).collect();
    assert_eq!(keys.len(), 2);
    let unread: BTreeSet<String> = keys.into_iter().take(1).collect();
    let mut half = bridge(Kept { unread, ..Kept::default() });
    half.frame(&header, payload.as_slice()).unwrap();
    assert_eq!(half.carrier().puts.len(), 1);
    assert_eq!(half.bridged().observations, 1);
}

#[test]
fn a_closed_session_is_an_error() {
    let mut bridge = bridge(Kept::default());
    bridge.carrier().is_closed = true;
    let (header, payload) = frame();
    let failed = bridge.frame(&header, payload.as_slice()).unwrap_err();
    assert_eq!(failed.to_string(), "zenoh: closed");
    let closed = Kept { is_closed: true, ..Kept::default() };
    let facts = TeamFacts { format: format(), ahead_ns: 0 };
    let failed = TeamBridge::open(closed, &node(), facts).err();
    assert!(matches!(failed, Some(BridgeError::Carrier(Closed))));
}

fn walking() -> PolicyFacts {
    PolicyFacts {
        inputs: vec![("gravity".to_owned(), 3), ("command".to_owned(), 1)],
        outputs: vec![("joints".to_owned(), 2)],
        actions: 0,
        joints: vec!["hip".to_owned(), "knee".to_owned()],
    }
}

fn observe(policy: &PolicyNode<Kept>, message: &Float32MultiArray) -> Result<Vec<f32>, String> {
    let mut bytes = Vec::new();
    encode(message, &mut bytes).unwrap();
    let attachment = Attachment { sequence: 1, source_ns: 5, gid: [7; 16] };
    let read = policy.read(&bytes, &attachment.to_bytes());
    read.map(|observed| observed.numbers).map_err(|error| error.to_string())
}

fn numbers(data: &[f32]) -> Float32MultiArray {
    Float32MultiArray { data: data.to_vec(), ..Float32MultiArray::default() }
}

#[test]
fn a_policy_reads_observations_and_commands_joints() {
    let mut policy = PolicyNode::open(Kept::default(), &node(), walking()).unwrap();
    let kinds = policy.carrier().tokens.iter().map(|token| Token::parse(token).unwrap());
    let kinds: Vec<_> = kinds
        .map(|token| (token.kind, token.topic.map_or(String::new(), |topic| topic.name)))
        .collect();
    let wanted = [
        (Kind::Node, ""),
        (Kind::Subscription, "/team/observation"),
        (Kind::Subscription, "/team/reset"),
        (Kind::Publisher, "/team/action"),
        (Kind::Publisher, "/team/joint_command"),
    ];
    assert_eq!(kinds, wanted.map(|(kind, topic)| (kind, topic.to_owned())));
    let reset = "0/team/reset/std_msgs::msg::dds_::Empty_/RIHS01_20b62525";
    assert!(policy.reset_key().starts_with(reset));
    let key = policy.observation_key();
    assert!(key.starts_with("0/team/observation/std_msgs::msg::dds_::Float32MultiArray_/RIHS01_"));

    assert_eq!(observe(&policy, &numbers(&[0., 0., -1., 0.5])).unwrap(), [0., 0., -1., 0.5]);
    policy.answer(Answer::Outputs(&[0.25, -0.5]), samples::SOURCE_NS).unwrap();
    let array = policy.carrier().take::<Float32MultiArray>("action");
    assert_eq!(array[0].1.data, [0.25, -0.5]);
    assert_eq!(array[0].1.layout.dim[0].label, "joints");
    let command = policy.carrier().take::<JointState>("joint_command");
    assert_eq!(command[0].1.name, ["hip", "knee"]);
    assert_eq!(command[0].1.position, [0.25, -0.5]);
    assert_eq!(command[0].1.header, samples::header(""));
}

#[test]
fn observations_of_other_policies_are_refused_by_what_differs() {
    let policy = PolicyNode::open(Kept::default(), &node(), walking()).unwrap();
    let refused = |message: &Float32MultiArray| observe(&policy, message).unwrap_err();
    assert_eq!(
        refused(&numbers(&[1.0; 3])),
        "it has 3 numbers; the policy takes 4: gravity [3], command [1]"
    );
    let mut shaped = numbers(&[1.0; 4]);
    shaped.layout.dim = samples::array().layout.dim;
    assert_eq!(
        refused(&shaped),
        "its layout is of 3 numbers behind 0, and it has 4; leave the layout empty"
    );
    shaped.layout.dim[0].size = 4;
    assert!(observe(&policy, &shaped).is_ok());
    shaped.layout.data_offset = 1;
    assert!(refused(&shaped).contains("behind 1"));
    let attachment = [0; 33];
    let read = policy.read(&[0, 1, 0, 0], &attachment).unwrap_err();
    assert!(matches!(read, ObservationError::Attachment(_)), "{read}");
    let whole = Attachment { sequence: 1, source_ns: 5, gid: [7; 16] }.to_bytes();
    let read = policy.read(&[0, 1, 0, 0], &whole).unwrap_err();
    assert_eq!(read, ObservationError::Cdr(CdrError::Short(Float32MultiArray::NAME)));
}

#[test]
fn a_policy_that_chooses_publishes_its_choice() {
    let facts = PolicyFacts { actions: 2, ..walking() };
    let mut policy = PolicyNode::open(Kept::default(), &node(), facts).unwrap();
    // Scores of actions are no joints.
    assert_eq!(policy.carrier().tokens.len(), 4);
    policy.answer(Answer::Choice(1), samples::SOURCE_NS).unwrap();
    let choice = policy.carrier().take::<Int32>("action");
    assert_eq!(choice[0].1, Int32 { data: 1 });
    assert_eq!(choice[0].0.source_ns, samples::SOURCE_NS as i64);
}
