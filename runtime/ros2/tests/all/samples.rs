//! The values that tests/independent.py writes.

use sortie_ros2::messages::{
    Action, Allocation, Float32MultiArray, Header, Int32, JointState, MultiArrayDimension,
    MultiArrayLayout, Observation, Text, Time,
};

pub(crate) const SOURCE_NS: u64 = 1_700_000_000_123_456_789;

pub(crate) fn header(frame_id: &str) -> Header {
    Header { stamp: Time::from_ns(SOURCE_NS), frame_id: frame_id.to_owned() }
}

pub(crate) fn text(data: &str) -> Text {
    Text { data: data.to_owned() }
}

pub(crate) fn choice() -> Int32 {
    Int32 { data: -7 }
}

pub(crate) fn array() -> Float32MultiArray {
    let dim = vec![MultiArrayDimension { label: "force".to_owned(), size: 3, stride: 3 }];
    let layout = MultiArrayLayout { dim, data_offset: 0 };
    Float32MultiArray { layout, data: vec![0.25, -1.5, 3.0e38] }
}

pub(crate) fn joints() -> JointState {
    JointState {
        header: header(""),
        name: vec!["hip".to_owned(), "knee_l".to_owned()],
        position: vec![0.5, -0.125],
        ..JointState::default()
    }
}

pub(crate) fn joints_moving() -> JointState {
    JointState {
        header: header("base"),
        name: vec!["hip".to_owned()],
        position: vec![0.5],
        velocity: vec![-1.0],
        effort: vec![2.5],
    }
}

pub(crate) fn observation() -> Observation {
    Observation {
        header: header("agent_3"),
        tick: 1 << 32 | 7,
        episode: 9,
        step: 4,
        agent: 3,
        flags: 3,
        entities: vec![3, 0, 8],
        features: 2,
        rows: vec![0.5, 1.0, -2.0, 0.0, 3.25, 1e-3],
        last_actions: vec![2, 65535, 65535],
        tasks: vec![1, 0, 1 << 31],
        open_tasks: 5,
        available: vec![1, 0, 1, 4, 0],
    }
}

pub(crate) fn action() -> Action {
    Action {
        header: header("agent_3"),
        tick: 1 << 32 | 7,
        agent: 3,
        action: 2,
        task: 255,
        flags: 40,
        utility: 7.125,
        decide_ns: 1900,
        alloc_term: 1,
        alloc_epoch: 17,
        runner: 4711,
    }
}

pub(crate) fn allocation() -> Allocation {
    Allocation {
        header: header(""),
        tick: 1 << 32 | 5,
        valid_until: 1 << 32 | 14,
        term: 1,
        epoch: 17,
        flags: 1,
        tasks: vec![0, 4, 255, 1, 2],
    }
}
