//! Who records may be late: nothing is lost, and all of it comes in its order.

use std::time::Duration;

use sortie_core::link::{ActionTx, AllocTx, FrameTx};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader};
use sortie_ipc::{
    BellKind, DomainFacts, Heard, Housekeeping, IoxAgent, IoxAllocator, IoxRecorder, IoxWorld,
    LinkSetup,
};
use zerocopy::FromZeros;

use crate::toy;

/// As long as [`IoxRecorder::receive`] says.
const TICKS: u64 = 16;
const AGENTS: u64 = toy::SHAPE.agents as u64;
/// A frame, an allocation, and the actions of all agents.
const MESSAGES: u64 = 2 + AGENTS;

#[test]
fn a_recorder_that_is_late_by_16_ticks_hears_all_of_them_in_the_order_of_their_sending() {
    let membership = toy::domain().enter().unwrap();
    let domain = membership.domain();
    let format = DomainFacts::new(&toy::contract(), toy::SHAPE).format().unwrap();
    let (bell, linger) = (BellKind::Doorbell, Duration::ZERO);
    let setup = |name| LinkSetup { domain, format, name, bell, linger };
    let mut recorder: IoxRecorder = IoxRecorder::open(&setup("recorder")).unwrap();
    let mut world: IoxWorld = IoxWorld::open(&setup("world")).unwrap();
    let mut agent: IoxAgent = IoxAgent::open(&setup("agent")).unwrap();
    let mut allocator: IoxAllocator = IoxAllocator::open(&setup("allocator")).unwrap();
    for link in [&mut world as &mut dyn Housekeeping, &mut agent, &mut allocator] {
        link.housekeep();
    }
    for tick in 0..TICKS {
        let t_ns = tick * MESSAGES;
        let fill = &mut |payload: &mut [u8]| {
            payload.fill(tick as u8);
            Ok(FrameHeader { t_ns, len: payload.len() as u32, ..FrameHeader::default() })
        };
        world.send_frame(fill).unwrap();
        let allocation = AllocMsg { t_ns: t_ns + 1, ..AllocMsg::new_zeroed() };
        allocator.send_allocation(&allocation).unwrap();
        // The last one answers first.
        for number in 0..AGENTS {
            let (agent_number, t_ns) = ((AGENTS - 1 - number) as u16, t_ns + 2 + number);
            let action = ActionMsg { t_ns, agent: agent_number, ..ActionMsg::new_zeroed() };
            agent.send_action(&action).unwrap();
        }
    }
    let mut heard = Vec::new();
    recorder
        .receive(&mut |message| {
            heard.push(match message {
                Heard::Frame(header, payload) => {
                    let tick = (header.t_ns / MESSAGES) as u8;
                    assert_eq!(payload.as_ptr().addr() % 64, 0, "views of it want that");
                    assert!(!payload.is_empty() && payload.iter().all(|byte| *byte == tick));
                    header.t_ns
                }
                Heard::Allocation(it) => it.t_ns,
                Heard::Action(it) => it.t_ns,
                Heard::Status(it) => panic!("nobody told of itself: {it:?}"),
            });
        })
        .unwrap();
    assert_eq!(heard, Vec::from_iter(0..TICKS * MESSAGES));
    recorder.receive(&mut |message| panic!("all was heard: {message:?}")).unwrap();
}
