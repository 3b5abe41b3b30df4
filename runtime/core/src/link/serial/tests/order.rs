//! What comes late, twice or not at all.

use std::vec;
use std::vec::Vec;

use zerocopy::FromZeros;

use super::{
    AGENTS, SCHEMA, SHAPE, Still, Wire, allocation, encoded, format, frame_packet, sealed, serial,
};
use crate::link::serial::packet::{ActionPacket, Packet, StatusPacket, Unpacker};
use crate::link::serial::{Relay, packet_bytes};
use crate::link::{AllocTx, Direct, DirectCursor, FrameBlock, FrameRx, StatRx};
use crate::wire::{ActionMsg, Role, StatMsg};

#[test]
fn a_frame_that_waits_is_not_replaced_by_an_older_one() {
    let wire = Wire::default();
    let mut link = serial(&wire);
    for tick in [7, 6, 7] {
        wire.0.borrow_mut().extend(encoded(&frame_packet(1 << 32 | tick)));
    }
    assert!(link.receive_frames(&mut |frame| frame.header.tick == 1 << 32 | 7).unwrap());
    assert_eq!((link.counters().packets, link.counters().overtaken), (3, 2));
    // One that has been looked at is nobody's rival: the runner counts what is old.
    wire.0.borrow_mut().extend(encoded(&frame_packet(1 << 32 | 6)));
    assert!(link.receive_frames(&mut |frame| frame.header.tick == 1 << 32 | 6).unwrap());
    assert_eq!(link.counters().overtaken, 2);
}

#[test]
fn damage_has_a_name() {
    let wire = Wire::default();
    let mut link = serial(&wire);
    let packet = encoded(&frame_packet(1 << 32 | 5));
    let torn = [&packet[..100], &[0]].concat();
    let mut corrupt = packet.clone();
    corrupt[60] ^= if corrupt[60] == 1 { 2 } else { 1 };
    wire.0.borrow_mut().extend([torn, corrupt, vec![0, 2, 9, 0]].concat());
    assert!(!link.receive_frames(&mut |_| true).unwrap());
    let counters = *link.counters();
    assert_eq!((counters.packets, counters.torn, counters.corrupt), (0, 2, 1));
}

/// The allocations that a relay sends when these packets come, after it has sent that of tick 7 and an older one, late.
fn sent_again(comes: &[Packet<'_>]) -> (Vec<u64>, u64) {
    let mut memory = vec![FrameBlock::zeroed(); format().layout.payload_bytes() / 64];
    let mut team = Direct::new(memory.as_mut_slice(), &Still);
    let [mut allocator, mut runner, mut world] = [DirectCursor::default(); 3];
    let mut packet = vec![0; packet_bytes(SHAPE)];
    let wire = Wire::default();
    let mut relay = Relay::new(wire.clone(), format(), AGENTS, &mut packet);
    for (tick, epoch) in [(7, 3), (6, 2)] {
        let message = crate::wire::AllocMsg { term: 1, epoch, ..allocation(tick) };
        team.allocator(&mut allocator).send_allocation(&message).unwrap();
        relay.turn(&mut team.agent(&mut runner)).unwrap();
    }
    wire.0.borrow_mut().clear();
    for packet in comes {
        wire.0.borrow_mut().extend(encoded(&sealed(|packer| packer.put(packet))));
    }
    relay.turn(&mut team.agent(&mut runner)).unwrap();
    let sent: Vec<u8> = wire.0.take().into();
    let mut ticks = Vec::new();
    for piece in sent.split(|byte| *byte == 0).filter(|piece| !piece.is_empty()) {
        let mut bytes = piece.to_vec();
        let len = cobs::decode_in_place(&mut bytes).unwrap();
        if let Some(Packet::Allocation(again)) = Unpacker(&bytes[..len - 4]).take() {
            ticks.push(again.message(0).unwrap().tick);
        }
    }
    let mut announced = 0;
    let mut end = team.world(&mut world);
    end.receive_statuses(&mut |status| announced += u64::from(status.agents == AGENTS)).unwrap();
    (ticks, announced)
}

#[test]
fn whoever_lacks_the_newest_allocation_is_sent_it_again() {
    let acts = |tick, epoch| {
        Packet::Action(ActionPacket::new(&ActionMsg {
            schema: SCHEMA,
            abi: 3,
            tick,
            alloc_term: 1,
            alloc_epoch: epoch,
            ..ActionMsg::new_zeroed()
        }))
    };
    // It acts on an earlier one; on the newest; on an earlier one in a tick before or long after it.
    assert_eq!(sent_again(&[acts(8, 2)]), (vec![7], 1), "and it is announced");
    assert_eq!(sent_again(&[acts(8, 3)]).0, []);
    assert_eq!(sent_again(&[acts(6, 2), acts(12, 2)]), (vec![], 1), "announced once");
    let hello = StatMsg {
        schema: SCHEMA,
        abi: 3,
        role: Role::Runner as u8,
        agents: AGENTS,
        flags: StatMsg::HELLO,
        ..StatMsg::new_zeroed()
    };
    let says =
        |status: &StatMsg| sent_again(&[Packet::Status(StatusPacket::new(status)), acts(8, 3)]);
    assert_eq!(says(&hello), (vec![7], 1), "who says hello needs no announcement");
    assert_eq!(says(&StatMsg { flags: 0, ..hello }), (vec![], 1));
}
