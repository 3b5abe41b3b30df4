//! Lines that lose, double and change bytes, by seeds; and frames that show the same at both ends.

mod order;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::format;
use std::rc::Rc;
use std::string::String;
use std::vec;
use std::vec::Vec;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use zerocopy::{FromZeros, IntoBytes};

use super::line::Line;
use super::packet::{ActionPacket, AllocationPacket, Packer, Packet, StatusPacket, Unpacker};
use super::{Serial, packet_bytes, view};
use crate::entity_mask::EntityMask;
use crate::link::{AllocRx, Bell, Clock, Frame, FrameBlock, FrameRx, Processor, Wake};
use crate::wire::{
    ABI, ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameKind, FrameLayout, FrameMut,
    FrameView, StatMsg,
};
use crate::world::Shape;

const SHAPE: Shape = Shape { agents: 3, entities: 70, tasks: 2, actions: 4, features: 67 };
const SCHEMA: u64 = 0x0102_0304_0506_0708;
/// The agents of the line.
const AGENTS: u64 = 0b101;

struct Still;

impl Clock for Still {
    fn now_ns(&self) -> u64 {
        5_000_000
    }
}

impl Processor for Still {}

#[derive(Clone, Default)]
struct Wire(Rc<RefCell<VecDeque<u8>>>);

impl ErrorType for Wire {
    type Error = Infallible;
}

impl Read for Wire {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let mut waiting = self.0.borrow_mut();
        // As much as lies in the buffer of a small port.
        let len = waiting.len().min(bytes.len()).min(16);
        bytes.iter_mut().zip(waiting.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl ReadReady for Wire {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().is_empty())
    }
}

impl Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let len = bytes.len().min(7);
        self.0.borrow_mut().extend(&bytes[..len]);
        Ok(len)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        self.0 >> 33
    }

    fn below(&mut self, end: usize) -> usize {
        self.next() as usize % end
    }
}

fn format() -> FrameFormat {
    FrameFormat { schema: SCHEMA, layout: FrameLayout::new(SHAPE).unwrap() }
}

/// A frame whose every number follows from its tick.
fn frame(tick: u64) -> (FrameHeader, Vec<FrameBlock>) {
    let layout = format().layout;
    let mut random = Random(tick);
    let mut payload = vec![FrameBlock::zeroed(); layout.payload_bytes() / 64];
    let mut frame = FrameMut::new(payload.as_mut_bytes(), layout).unwrap();
    let set = |random: &mut Random| {
        EntityMask::from_words(&[random.next() << 32 | random.next(), random.next()])
    };
    let mut present = set(&mut random);
    (0..SHAPE.agents).for_each(|agent| present.insert(agent));
    frame.set_present(&present);
    for agent in 0..SHAPE.agents {
        frame.set_observable(agent, &set(&mut random));
        frame.set_last_action(agent, random.below(4) as u16);
        for code in frame.available_mut(agent) {
            *code = random.below(3) as u16;
        }
    }
    for entity in 0..SHAPE.entities {
        frame.set_entity_task(entity, random.below(4) as u32);
        for feature in frame.row_mut(entity) {
            let is_zero = random.below(3) > 0;
            *feature = if is_zero { 0.0 } else { f32::from_bits(random.next() as u32) };
        }
    }
    frame.set_open_tasks(0b10);
    frame.set_progress(3, tick - 1, 0b101);
    let header = FrameHeader {
        magic: FrameHeader::MAGIC,
        abi: ABI,
        kind: FrameKind::World as u16,
        schema: SCHEMA,
        seq: tick,
        tick,
        t_ns: 1,
        deadline_ns: 9_000_000,
        len: layout.payload_bytes() as u32,
        flags: 0,
        generation: 3,
        world_term: (tick >> 32) as u32,
        episode: 1,
    };
    (header, payload)
}

fn allocation(tick: u64) -> AllocMsg {
    let mut message = AllocMsg {
        schema: SCHEMA,
        seq: tick,
        tick,
        valid_until: tick + 4,
        n_agents: 3,
        n_tasks: 2,
        abi: 3,
        task: [0xFF; 64],
        ..AllocMsg::new_zeroed()
    };
    message.task[..3].copy_from_slice(&[(tick % 2) as u8, 1, 0xFF]);
    message
}

fn sealed(write: impl FnOnce(&mut Packer<'_>) -> Option<()>) -> Vec<u8> {
    let mut bytes = vec![0; packet_bytes(SHAPE)];
    let mut packer = Packer::new(&mut bytes);
    write(&mut packer).unwrap();
    packer.seal().unwrap().to_vec()
}

fn frame_packet(tick: u64) -> Vec<u8> {
    let (header, payload) = frame(tick);
    let frame = Frame { header: &header, payload: payload.as_bytes() };
    sealed(|packer| view::write(frame, &format(), AGENTS, 5_000_000, packer))
}

fn allocation_packet(tick: u64) -> Vec<u8> {
    sealed(|packer| packer.put(&Packet::Allocation(AllocationPacket::new(&allocation(tick)))))
}

/// A packet as the line carries it.
fn encoded(packet: &[u8]) -> Vec<u8> {
    let wire = Wire::default();
    Line::new(wire.clone(), [0; 0]).send(packet).unwrap();
    wire.0.take().into()
}

fn serial(wire: &Wire) -> Serial<'static, Wire> {
    let memory = vec![FrameBlock::zeroed(); FrameBlock::for_serial(SHAPE)].leak();
    let packet = vec![0; packet_bytes(SHAPE)].leak();
    Serial::new(wire.clone(), &Still, format(), memory, packet).unwrap()
}

/// Asserts that a frame shows of the frame of its tick what the line's agents see, bit for bit.
fn assert_true(got: Frame<'_>) {
    let (header, payload) = frame(got.header.tick);
    let want = FrameView::new(&header, payload.as_bytes(), &format()).unwrap();
    let view = FrameView::new(got.header, got.payload, &format()).unwrap();
    assert_eq!((got.header.t_ns, got.header.deadline_ns), (5_000_000, 9_000_000));
    assert_eq!((view.step(), view.absent(), view.open_tasks()), (3, 0b101, 0b10));
    assert_eq!(view.decision_tick(), want.decision_tick());
    let mut seen = EntityMask::from_words(&[AGENTS]);
    for agent in [0, 2] {
        seen = seen.or(&want.observable(agent));
        let sees = |view: &FrameView<'_>| view.observable(agent).and(&view.present());
        assert_eq!(sees(&view), sees(&want));
        assert_eq!(view.available(agent), want.available(agent));
        assert_eq!(view.last_actions()[agent], want.last_actions()[agent]);
    }
    // Networks read the last actions of all agents that are seen, agent 1 among them.
    let shown = seen.and(&want.present());
    let last_actions = |view: &FrameView<'_>| {
        (0..SHAPE.agents)
            .filter(|&agent| shown.contains(agent))
            .map(|agent| view.last_actions()[agent])
            .collect::<Vec<_>>()
    };
    assert_eq!(last_actions(&view), last_actions(&want));
    assert_eq!(view.present(), seen.and(&want.present()));
    assert!(view.observable(1).is_empty());
    for entity in 0..SHAPE.entities {
        let row = |view: &FrameView<'_>| {
            let features = &view.rows()[entity * view.stride()..][..view.stride()];
            features.iter().map(|feature| feature.to_bits()).collect::<Vec<_>>()
        };
        if view.present().contains(entity) {
            assert_eq!(row(&view), row(&want));
            assert_eq!(view.entity_task()[entity], want.entity_task()[entity]);
        } else {
            assert!(row(&view).iter().all(|bits| *bits == 0), "entity {entity} is not seen");
        }
    }
}

#[test]
fn a_frame_shows_what_the_agents_see() {
    let wire = Wire::default();
    let mut link = serial(&wire);
    for tick in (1_u64 << 32) + 10..(1 << 32) + 30 {
        wire.0.borrow_mut().extend(encoded(&frame_packet(tick)));
        assert!(link.receive_frames(&mut |frame| frame.header.tick == tick).unwrap());
        assert_true(link.frame().unwrap());
        // One that is not wanted takes nothing away.
        wire.0.borrow_mut().extend(encoded(&frame_packet(tick + 1)));
        assert!(!link.receive_frames(&mut |_| false).unwrap());
        assert_true(link.frame().unwrap());
    }
}

#[test]
fn the_longest_packets_have_room() {
    let full = StatMsg { counters: [u64::MAX; 16], name: [b'x'; 48], ..StatMsg::new_zeroed() };
    let full = StatMsg { hist_wake: [u32::MAX; 32], hist_work: [u32::MAX; 32], ..full };
    let packet = sealed(|packer| packer.put(&Packet::Status(StatusPacket::new(&full))));
    assert!(packet.len() <= super::packet::SMALL_PACKET);
    let mut unpacker = Unpacker(&packet[..packet.len() - 4]);
    let Some(Packet::Status(status)) = unpacker.take() else { panic!("no status") };
    assert_eq!(status.message(0), Some(full));
}

/// What noise does to bytes: some change, some are lost, some come twice, some come from nowhere.
fn with_noise(bytes: &[u8], random: &mut Random, one_in: usize) -> Vec<u8> {
    let mut noisy = Vec::new();
    for &byte in bytes {
        match random.below(5 * one_in) {
            0 => noisy.push(byte ^ 1 << random.below(8)),
            1 => noisy.push(random.next() as u8),
            2 => {}
            3 => noisy.extend([byte, byte]),
            4 => noisy.extend((0..random.below(300)).map(|_| random.next() as u8)),
            _ => noisy.push(byte),
        }
    }
    noisy
}

/// Sends frames and allocations through noise. Everything that is taken is one that was sent; what is sent
/// after the noise arrives; and each thing that was not damaged is counted as whole.
fn survive(seed: u64, one_in: usize) -> u64 {
    let (wire, mut random) = (Wire::default(), Random(seed));
    let mut link = serial(&wire);
    let first = (1_u64 << 32) + 10;
    let mut taken = 0;
    for tick in first..first + 40 {
        let frame = encoded(&frame_packet(tick));
        let allocated = encoded(&allocation_packet(tick));
        let sent = [frame, allocated].concat();
        let whole = sent.clone();
        let noisy = with_noise(&sent, &mut random, one_in);
        let is_whole = noisy == whole;
        wire.0.borrow_mut().extend(noisy);
        let fresh = link.receive_frames(&mut |frame| {
            assert!((first..=tick).contains(&frame.header.tick), "seed {seed}");
            assert_true(frame);
            true
        });
        let mut allocations = 0;
        link.receive_allocations(&mut |message| {
            let sent = AllocMsg { t_ns: message.t_ns, ..allocation(message.tick) };
            assert_eq!(*message, sent, "seed {seed}");
            allocations += 1;
        })
        .unwrap();
        taken += u64::from(fresh.unwrap());
        // What came whole after noise is only lost to a packet that had begun before.
        assert!(!is_whole || allocations == 1, "seed {seed} tick {tick}");
    }
    wire.0.borrow_mut().extend(encoded(&frame_packet(first + 99)));
    assert!(link.receive_frames(&mut |_| true).unwrap(), "seed {seed}");
    assert_eq!(link.frame().unwrap().header.tick, first + 99);
    assert_eq!(link.counters().refused, 0, "seed {seed}");
    taken
}

#[test]
fn noise_never_makes_a_message() {
    let taken: u64 = (0..60).map(|seed| survive(seed, 2_000)).sum();
    assert!(taken > 60, "the noise leaves something: {taken}");
    (60..120).for_each(|seed| {
        survive(seed, 40);
    });
}

#[test]
fn packets_of_another_domain_are_refused_whole() {
    let wire = Wire::default();
    let mut link = serial(&wire);
    // Well formed, but cut short or with something behind.
    let packet = frame_packet(1 << 32 | 5);
    let body = &packet[..packet.len() - 4];
    for body in [&body[..body.len() - 1], &[body, &[7]].concat(), &body[..1], &[9], &[]] {
        let packet = sealed(|packer| body.iter().try_for_each(|byte| packer.put(byte)));
        wire.0.borrow_mut().extend(encoded(&packet));
    }
    assert!(!link.receive_frames(&mut |_| true).unwrap());
    assert_eq!((link.counters().packets, link.counters().refused), (5, 5));
    // Longer than there is room.
    wire.0.borrow_mut().extend(encoded(&vec![1; packet_bytes(SHAPE) + 1]));
    wire.0.borrow_mut().extend(encoded(&frame_packet(1 << 32 | 6)));
    assert!(link.receive_frames(&mut |_| true).unwrap());
    assert_eq!(link.counters().too_long, 1);
}

/// Bytes as hexadecimal digits.
fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn packets_are_what_they_always_were() {
    let action = ActionMsg {
        schema: SCHEMA,
        seq: 300,
        tick: 1 << 32 | 7,
        t_ns: 5_000_000,
        model: 0xDEAD_BEEF,
        alloc_epoch: 2,
        agent: 2,
        action: 3,
        flags: ActionMsg::LATE,
        task: 1,
        abi: 3,
        q: 1.5,
        decide_ns: 4_000,
        alloc_term: 1,
        runner: 4_711,
    };
    let mut status = StatMsg {
        schema: SCHEMA,
        seq: 2,
        start_ns: 4_000_000,
        pid: 4_711,
        role: 1,
        abi: 3,
        n_agents: 1,
        agents: 0b100,
        last_tick: 1 << 32 | 7,
        model: [9; 16],
        flags: StatMsg::HELLO,
        ..StatMsg::new_zeroed()
    };
    status.name[..7].copy_from_slice(b"agent/2");
    let packets = [
        sealed(|packer| packer.put(&Packet::Action(ActionPacket::new(&action)))),
        allocation_packet(1 << 32 | 7),
        sealed(|packer| packer.put(&Packet::Status(StatusPacket::new(&status)))),
    ];
    let golden = [
        "001c02080706050403020103ac028780808010effdb6f50d0202030801010cc03fa01f01e7244fcff6d400",
        "001a01080706050403020103878080801087808080108b8080801001010103030209030101ff0e1acc3100",
        "000d0308070605040302010301021ae7240104878080801009090909090909090909090909090909020101010d\
         076167656e742f323375c0a800",
    ];
    assert_eq!(packets.map(|packet| digits(&encoded(&packet))), golden);
    // A frame of 70 entities is long: its checksum stands for it.
    let frame = frame_packet(1 << 32 | 7);
    let (_, checksum) = frame.split_last_chunk::<4>().unwrap();
    assert_eq!((frame.len(), digits(checksum).as_str()), (2_652, "709e0ad4"));
}

#[test]
fn whatever_comes_wakes() {
    let wire = Wire::default();
    let mut link = serial(&wire);
    let token = link.token();
    assert_eq!(link.wait_until(token, 0), Wake::Timeout);
    wire.0.borrow_mut().extend(encoded(&allocation_packet(7)));
    assert_eq!(link.wait_until(token, u64::MAX), Wake::Rung);
}
