//! The messages that cross: standard ones where they fit, those of `sortie_msgs` where they do not.
//!
//! Fields are those of the definitions, in their order: plain CDR knows no names.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// A type of ROS 2.
pub trait Message: Serialize + DeserializeOwned {
    /// `package/msg/Name`.
    const NAME: &'static str;
}

/// The definition of a type that crosses or is part of one.
pub fn definition(name: &str) -> Option<&'static str> {
    DEFINITIONS.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// All of them. Those of ROS itself without their comments, which do not count.
pub const DEFINITIONS: [(&str, &str); 12] = [
    ("builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec\n"),
    ("std_msgs/msg/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("std_msgs/msg/String", "string data\n"),
    ("std_msgs/msg/Int32", "int32 data\n"),
    // What its generators put into types without a field.
    ("std_msgs/msg/Empty", "uint8 structure_needs_at_least_one_member\n"),
    ("std_msgs/msg/MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n"),
    ("std_msgs/msg/MultiArrayLayout", "MultiArrayDimension[] dim\nuint32 data_offset\n"),
    ("std_msgs/msg/Float32MultiArray", "MultiArrayLayout layout\nfloat32[] data\n"),
    (
        "sensor_msgs/msg/JointState",
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    ),
    ("sortie_msgs/msg/Observation", include_str!("../sortie_msgs/msg/Observation.msg")),
    ("sortie_msgs/msg/Action", include_str!("../sortie_msgs/msg/Action.msg")),
    ("sortie_msgs/msg/Allocation", include_str!("../sortie_msgs/msg/Allocation.msg")),
];

/// A time since 1970.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds of the next.
    pub nanosec: u32,
}

impl Time {
    /// So many nanoseconds after 1970 began; the year 2038 at most, where ROS's seconds end.
    pub fn from_ns(ns: u64) -> Self {
        const SECOND: u64 = 1_000_000_000;
        Self { sec: i32::try_from(ns / SECOND).unwrap_or(i32::MAX), nanosec: (ns % SECOND) as u32 }
    }
}

/// When something was, and of what.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When.
    pub stamp: Time,
    /// The frame that positions are in; of team messages the agent, `agent_3`.
    pub frame_id: String,
}

/// `std_msgs/msg/String`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Text {
    /// What it says.
    pub data: String,
}

impl Message for Text {
    const NAME: &'static str = "std_msgs/msg/String";
}

/// `std_msgs/msg/Int32`: an action that a policy has chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Int32 {
    /// The number.
    pub data: i32,
}

impl Message for Int32 {
    const NAME: &'static str = "std_msgs/msg/Int32";
}

/// `std_msgs/msg/Empty`: that something is to be done now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Empty {
    /// Always 0.
    pub structure_needs_at_least_one_member: u8,
}

impl Message for Empty {
    const NAME: &'static str = "std_msgs/msg/Empty";
}

/// A dimension of an array.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MultiArrayDimension {
    /// Its name.
    pub label: String,
    /// How many there are along it.
    pub size: u32,
    /// Numbers of this and all later dimensions.
    pub stride: u32,
}

/// How the numbers of an array lie.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MultiArrayLayout {
    /// Dimensions, the outermost first.
    pub dim: Vec<MultiArrayDimension>,
    /// Numbers before the first that counts.
    pub data_offset: u32,
}

/// `std_msgs/msg/Float32MultiArray`: what a policy observes or does.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Float32MultiArray {
    /// How they lie.
    pub layout: MultiArrayLayout,
    /// The numbers.
    pub data: Vec<f32>,
}

impl Message for Float32MultiArray {
    const NAME: &'static str = "std_msgs/msg/Float32MultiArray";
}

/// `sensor_msgs/msg/JointState`: what joints are to do, by name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// When.
    pub header: Header,
    /// The joints.
    pub name: Vec<String>,
    /// Of each joint, radians or metres; or of none.
    pub position: Vec<f64>,
    /// Of each joint, radians or metres a second; or of none.
    pub velocity: Vec<f64>,
    /// Of each joint, newton metres or newtons; or of none.
    pub effort: Vec<f64>,
}

impl Message for JointState {
    const NAME: &'static str = "sensor_msgs/msg/JointState";
}

/// `sortie_msgs/msg/Observation`: what one agent sees of one tick.
///
/// Row 0 is the agent's own; what it sees follows in rising order, itself among them where it sees itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// When the world published the frame, and whose it is.
    pub header: Header,
    /// The world's term in the upper half.
    pub tick: u64,
    /// Episode, its low 32 bits.
    pub episode: u32,
    /// Step in the episode.
    pub step: u32,
    /// The agent.
    pub agent: u16,
    /// Flags of [`FrameHeader`](sortie_core::wire::FrameHeader).
    pub flags: u16,
    /// Which entity each row shows.
    pub entities: Vec<u16>,
    /// d, the numbers of a row.
    pub features: u32,
    /// `[rows, d]`
    pub rows: Vec<f32>,
    /// Of each row; [`NO_ACTION`](sortie_core::NO_ACTION) where there was none.
    pub last_actions: Vec<u16>,
    /// Of each row: bit t where its entity belongs to subtask t.
    pub tasks: Vec<u32>,
    /// Bit t: subtask t is present and not finished.
    pub open_tasks: u32,
    /// Of each action; 0 = not available.
    pub available: Vec<u16>,
}

impl Message for Observation {
    const NAME: &'static str = "sortie_msgs/msg/Observation";
}

/// `sortie_msgs/msg/Action`: what one agent does in one tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Action {
    /// When it was sent, and for whom.
    pub header: Header,
    /// The frame that it answers.
    pub tick: u64,
    /// The agent.
    pub agent: u16,
    /// The action, or [`NO_ACTION`](sortie_core::NO_ACTION).
    pub action: u16,
    /// The subtask acted for, or [`UNASSIGNED`](sortie_core::UNASSIGNED).
    pub task: u8,
    /// Flags of [`ActionMsg`](sortie_core::wire::ActionMsg).
    pub flags: u16,
    /// The network's utility of the action.
    pub utility: f32,
    /// Time of the decision alone.
    pub decide_ns: u32,
    /// Term of the allocation acted on.
    pub alloc_term: u32,
    /// Epoch of the allocation acted on.
    pub alloc_epoch: u32,
    /// Process id of who decided.
    pub runner: u32,
}

impl Message for Action {
    const NAME: &'static str = "sortie_msgs/msg/Action";
}

/// `sortie_msgs/msg/Allocation`: who works on which subtask.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Allocation {
    /// When it was sent.
    pub header: Header,
    /// The frame that it was computed from.
    pub tick: u64,
    /// Last tick for which agents may use it.
    pub valid_until: u64,
    /// Leadership term of the allocator.
    pub term: u32,
    /// One more with every message of a term.
    pub epoch: u32,
    /// Flags of [`AllocMsg`](sortie_core::wire::AllocMsg).
    pub flags: u32,
    /// Subtask of each agent, or [`UNASSIGNED`](sortie_core::UNASSIGNED).
    pub tasks: Vec<u8>,
}

impl Message for Allocation {
    const NAME: &'static str = "sortie_msgs/msg/Allocation";
}
