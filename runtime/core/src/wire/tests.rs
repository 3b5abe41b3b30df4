//! The messages against bytes that another program packed, field by field, from the documented
//! layout; and frames that must not be read.

use std::string::String;
use std::vec::Vec;
use std::{array, format};

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::*;
use crate::entity_mask::EntityMask;
use crate::link::FrameBlock;
use crate::world::Shape;

const SCHEMA: u64 = 0x0102_0304_0506_0708;
const TICK: u64 = 0x2_0000_0003;
const SHAPE: Shape = Shape { agents: 2, entities: 3, tasks: 2, actions: 3, features: 5 };

const FRAME_HEADER: &str = "\
    534f52540300010008070605040302011100000000000000030000000200000088776655443322119988776655443322\
    0002000003000b0a0200000009000000\
";
const FRAME_PAYLOAD: &str = "\
    020003000200030005000800ffff000002000000030000004000000080000000c0000000000100004001000080010000\
    030000000200000001000000000000000500000000000000000000000000000000000000000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000001000000000000000700000000000000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    010000000200000003000000000000000000000000000000000000000000000000000000000000000000000000000000\
    000000000000000000000000000000000000010000000100000007000000000000000000000000000000000000000000\
    00000000000000000000000000000000000000000000000000000000000000000200ffff000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    000000000000803f00000040000040400000804000000000000000000000000000002041000030410000404100005041\
    000060410000000000000000000000000000a0410000a8410000b0410000b8410000c041000000000000000000000000\
    0000000000000000000000000000000000000000000000000000000000000000\
";
const PRIVATE_PAYLOAD: &str = "\
    0100030002000300050008000000000002000000030000004000000080000000c0000000000100004001000080010000\
    030000000200000001000000000000000100000000000000000000000000000000000000000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000001000000000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    010000000100000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    000000000000000000000000000000000000010000000000000000000000000000000000000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000002000200ffffffff0000000000000000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    000000000000803f000000400000404000008040000000000000000000000000000000000000803f0000004000004040\
    000080400000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    0000000000000000000000000000000000000000000000000000000000000000\
";
const ACTION: &str = "\
    0807060504030201120000000000000003000000020000003300000000000000a4a3a2a10700000005000b0021000303\
    0000c0bfd204000002000000e1100000\
";
const ALLOCATION: &str = "\
    080706050403020113000000000000000300000002000000440000000000000007000000020000000200000007000000\
    b4b3b2b12e16000003000203030000000001ff0000000000000000000000000000000000000000000000000000000000\
    0000000000000000000000000000000000000000000000000000000000000000\
";
const STATUS: &str = "\
    0807060504030201140000000000000055000000000000006600000000000000e1100000010302000500000000000000\
    0300000002000000000102030405060708090a0b0c0d0e0f4d0000000900000064000000000000006500000000000000\
    66000000000000006700000000000000680000000000000069000000000000006a000000000000006b00000000000000\
    6c000000000000006d000000000000006e000000000000006f0000000000000070000000000000007100000000000000\
    72000000000000007300000000000000c8000000c9000000ca000000cb000000cc000000cd000000ce000000cf000000\
    d0000000d1000000d2000000d3000000d4000000d5000000d6000000d7000000d8000000d9000000da000000db000000\
    dc000000dd000000de000000df000000e0000000e1000000e2000000e3000000e4000000e5000000e6000000e7000000\
    2c0100002d0100002e0100002f0100003001000031010000320100003301000034010000350100003601000037010000\
    38010000390100003a0100003b0100003c0100003d0100003e0100003f01000040010000410100004201000043010000\
    4401000045010000460100004701000048010000490100004a0100004b01000072756e6e65722f300000000000000000\
    0000000000000000000000000000000000000000000000000000000000000000\
";
const CONTROL_REQUEST: &str = "\
    080706050403020106000300e11000006600000000000000770000000000000072656769737472792d6b657900000000\
    00000000000000000000000000000000\
";
const CONTROL_ANSWER: &str = "\
    0807060504030201060003000200000003000000020000007700000000000000726f6c653d72756e6e6572207069643d\
    343332310000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000\
    00000000000000000000000000000000\
";

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn assert_golden<M>(message: M, golden: &str)
where
    M: FromBytes + IntoBytes + Immutable + KnownLayout + PartialEq + core::fmt::Debug,
{
    assert_eq!(hex(message.as_bytes()), golden);
    let bytes: Vec<u8> = golden.as_bytes().chunks(2).map(byte).collect();
    assert_eq!(M::read_from_bytes(&bytes).unwrap(), message);
}

fn byte(digits: &[u8]) -> u8 {
    u8::from_str_radix(core::str::from_utf8(digits).unwrap(), 16).unwrap()
}

fn header() -> FrameHeader {
    FrameHeader {
        magic: FrameHeader::MAGIC,
        abi: ABI,
        kind: FrameKind::World as u16,
        schema: SCHEMA,
        seq: 0x11,
        tick: TICK,
        t_ns: 0x1122_3344_5566_7788,
        deadline_ns: 0x2233_4455_6677_8899,
        len: 512,
        flags: FrameHeader::EPISODE_START | FrameHeader::REALLOC,
        generation: 0x0A0B,
        world_term: 2,
        episode: 9,
    }
}

#[test]
fn frame_header_has_its_golden_bytes() {
    assert_golden(header(), FRAME_HEADER);
}

#[test]
fn action_has_its_golden_bytes() {
    let action = ActionMsg {
        schema: SCHEMA,
        seq: 0x12,
        tick: TICK,
        t_ns: 0x33,
        model: 0xA1A2_A3A4,
        alloc_epoch: 7,
        agent: 5,
        action: 11,
        flags: ActionMsg::STALE_ALLOC | ActionMsg::FALLBACK,
        task: 3,
        abi: 3,
        q: -1.5,
        decide_ns: 1234,
        alloc_term: 2,
        runner: 4321,
    };
    assert_golden(action, ACTION);
}

#[test]
fn allocation_has_its_golden_bytes() {
    let mut task = [0; 64];
    task[..3].copy_from_slice(&[0, 1, 255]);
    let allocation = AllocMsg {
        schema: SCHEMA,
        seq: 0x13,
        tick: TICK,
        t_ns: 0x44,
        valid_until: TICK + 4,
        term: 2,
        epoch: 7,
        model: 0xB1B2_B3B4,
        decide_ns: 5678,
        n_agents: 3,
        n_tasks: 2,
        abi: 3,
        flags: AllocMsg::FIRST_OF_TERM | AllocMsg::PARTIAL,
        task,
    };
    assert_golden(allocation, ALLOCATION);
}

#[test]
fn status_has_its_golden_bytes() {
    let mut name = [0; 48];
    name[..8].copy_from_slice(b"runner/0");
    let status = StatMsg {
        schema: SCHEMA,
        seq: 0x14,
        t_ns: 0x55,
        start_ns: 0x66,
        pid: 4321,
        role: Role::Runner as u8,
        abi: 3,
        n_agents: 2,
        agents: 0b101,
        last_tick: TICK,
        model: array::from_fn(|index| index as u8),
        build: 77,
        flags: StatMsg::HELLO | StatMsg::LEADER,
        counters: array::from_fn(|index| 100 + index as u64),
        hist_wake: array::from_fn(|index| 200 + index as u32),
        hist_work: array::from_fn(|index| 300 + index as u32),
        name,
    };
    assert_golden(status, STATUS);
}

#[test]
fn control_has_its_golden_bytes() {
    let mut text = [0; 32];
    text[..12].copy_from_slice(b"registry-key");
    let request = ControlReq {
        arg: 4321,
        arg64: 0x66,
        token: 0x77,
        text,
        ..ControlReq::new(SCHEMA, Command::PrepareBundle)
    };
    assert_golden(request, CONTROL_REQUEST);
    let answer = request.answer(SCHEMA, ControlStatus::NotSupported, TICK);
    assert_golden(answer.with_text("role=runner pid=4321"), CONTROL_ANSWER);
}

#[test]
fn commands_and_their_outcomes_are_numbers() {
    let known: Vec<u16> = (0..=u16::MAX)
        .filter(|&number| Command::from_number(number).is_some_and(|c| c as u16 == number))
        .collect();
    assert_eq!(known, [1, 2, 3, 4, 5, 6, 7, 8, 9]);
    let known: Vec<i32> = (-9..99)
        .filter(|&number| ControlStatus::from_number(number).is_some_and(|s| s as i32 == number))
        .collect();
    assert_eq!(known, [0, 1, 2, 3, 4, 5]);
}

#[test]
fn control_texts_end_where_they_are_no_text() {
    let answer = ControlReq::new(SCHEMA, Command::Info).answer(SCHEMA, ControlStatus::Done, 0);
    assert_eq!((answer.text(), answer.with_text("role=world").text()), ("", "role=world"));
    let long = "x".repeat(300);
    assert_eq!(answer.with_text(&long).text(), &long[..224]);
    // A letter that is cut in two is left out.
    let cut = std::format!("{}\u{e4}", "x".repeat(223));
    assert_eq!(answer.with_text(&cut).text(), &cut[..223]);
}

fn format() -> FrameFormat {
    FrameFormat { schema: SCHEMA, layout: FrameLayout::new(SHAPE).unwrap() }
}

/// Writes the frame of the golden bytes.
fn fill(memory: &mut [FrameBlock]) {
    let mut frame = FrameMut::new(memory.as_mut_bytes(), format().layout).unwrap();
    frame.set_present(&EntityMask::from_words(&[0b101]));
    frame.set_observable(0, &EntityMask::from_words(&[0b001]));
    frame.set_observable(1, &EntityMask::from_words(&[0b111]));
    for (entity, tasks) in [0b01, 0b10, 0b11].into_iter().enumerate() {
        frame.set_entity_task(entity, tasks);
        for (column, feature) in frame.row_mut(entity).iter_mut().enumerate() {
            *feature = (10 * entity + column) as f32;
        }
    }
    frame.available_mut(0).copy_from_slice(&[0, 1, 0]);
    frame.available_mut(1).copy_from_slice(&[1, 0, 7]);
    frame.set_last_action(0, 2);
    frame.set_open_tasks(0b10);
    frame.set_progress(3, TICK, 0b01);
}

fn memory() -> [FrameBlock; 8] {
    let mut memory = [FrameBlock::zeroed(); 8];
    // What an earlier frame left must not show.
    memory.as_mut_bytes().fill(0xEE);
    fill(&mut memory);
    memory
}

#[test]
fn frame_payload_has_its_golden_bytes() {
    assert_eq!(hex(memory().as_bytes()), FRAME_PAYLOAD);
}

#[test]
fn a_view_gives_what_was_written() {
    let (memory, header) = (memory(), header());
    let view = FrameView::new(&header, memory.as_bytes(), &format()).unwrap();
    assert_eq!((view.agents(), view.step(), view.absent()), (2, 3, 0b01));
    assert_eq!((view.decision_tick(), view.episode_start()), (TICK, TICK - 3));
    assert!(view.present().iter().eq([0, 2]));
    assert!(view.observable(1).iter().eq([0, 1, 2]));
    assert!(view.observable(2).is_empty());
    assert_eq!(view.entity_task(), [0b01, 0b10, 0b11]);
    assert_eq!((view.available(1), view.available(2)), (&[1, 0, 7][..], &[][..]));
    assert_eq!(view.last_actions(), [2, 0xFFFF]);
    assert_eq!(view.rows()[2 * view.stride()..][..5], [20.0, 21.0, 22.0, 23.0, 24.0]);
    let state = view.allocation_state();
    assert_eq!((state.agents, state.tasks, state.open_tasks), (2, 2, 0b10));
    assert!(state.present.iter().eq([2]), "an agent for which nobody acts is not counted on");
}

#[test]
fn writing_beyond_the_domain_is_ignored() {
    let mut memory = memory();
    let mut frame = FrameMut::new(memory.as_mut_bytes(), format().layout).unwrap();
    frame.set_present(&EntityMask::first(128));
    frame.set_observable(0, &EntityMask::first(128));
    frame.set_observable(9, &EntityMask::first(128));
    frame.set_entity_task(0, u32::MAX);
    frame.set_entity_task(usize::MAX, u32::MAX);
    frame.set_open_tasks(u32::MAX);
    frame.set_progress(0, 0, u64::MAX);
    assert!(frame.row_mut(3).is_empty());
    assert!(frame.row_mut(usize::MAX).is_empty());
    assert!(frame.available_mut(usize::MAX).is_empty());
    let header = header();
    let view = FrameView::new(&header, memory.as_bytes(), &format()).unwrap();
    assert_eq!((view.present().len(), view.observable(1).len()), (3, 0));
}

#[test]
fn what_does_not_fit_the_domain_is_refused() {
    let (memory, header) = (memory(), header());
    let refusal = |header: &FrameHeader, payload: &[u8]| {
        FrameView::new(header, payload, &format()).map(|_| ()).unwrap_err()
    };
    let payload = memory.as_bytes();
    for foreign in [
        FrameHeader { magic: 0, ..header },
        FrameHeader { abi: 1, ..header },
        FrameHeader { schema: 1, ..header },
    ] {
        assert_eq!(refusal(&foreign, payload), FrameError::Foreign);
    }
    assert_eq!(refusal(&header, &payload[..448]), FrameError::Length);
    assert_eq!(refusal(&FrameHeader { len: 448, ..header }, payload), FrameError::Length);
    // Shifted by four bytes: aligned for the features, not for the sets.
    let mut shifted = [FrameBlock::zeroed(); 9];
    let place = &mut shifted.as_mut_bytes()[4..][..512];
    place.copy_from_slice(payload);
    assert_eq!(refusal(&header, place), FrameError::Length);
}

/// Every single changed bit is either refused or gives a view within the domain.
#[test]
fn no_bit_makes_a_view_name_what_does_not_exist() {
    let header = header();
    for bit in 0..512 * 8 {
        let mut memory = memory();
        memory.as_mut_bytes()[bit / 8] ^= 1 << (bit % 8);
        let Ok(view) = FrameView::new(&header, memory.as_bytes(), &format()) else { continue };
        assert!(view.present().iter().all(|entity| entity < 3), "bit {bit}");
        assert!((0..2).all(|agent| view.observable(agent).iter().all(|entity| entity < 3)));
        assert!(view.entity_task().iter().all(|tasks| tasks >> 2 == 0), "bit {bit}");
        assert!(view.last_actions().iter().all(|&last| last < 3 || last == 0xFFFF), "bit {bit}");
        assert!(view.open_tasks() >> 2 == 0 && view.absent() >> 2 == 0, "bit {bit}");
        assert_eq!((view.agents(), view.stride()), (2, 8));
    }
}

#[test]
fn an_allocation_of_another_shape_is_dropped() {
    let allocation = AllocMsg {
        schema: SCHEMA,
        abi: 3,
        n_agents: 2,
        n_tasks: 2,
        task: [0xFF; 64],
        ..AllocMsg::read_from_bytes(&[0; 128]).unwrap()
    };
    assert_eq!(allocation.check(SCHEMA, SHAPE), Ok(()));
    let mut beyond = allocation;
    beyond.task[1] = 2;
    assert_eq!(beyond.check(SCHEMA, SHAPE), Err(AllocationFault::Content));
    // A seat that the domain does not have is not looked at.
    beyond.task = allocation.task;
    beyond.task[2] = 2;
    assert_eq!(beyond.check(SCHEMA, SHAPE), Ok(()));
    let other = AllocMsg { n_agents: 3, ..allocation };
    assert_eq!(other.check(SCHEMA, SHAPE), Err(AllocationFault::Content));
    let foreign = AllocMsg { abi: 1, ..allocation };
    assert_eq!(foreign.check(SCHEMA, SHAPE), Err(AllocationFault::Foreign));
    assert_eq!(allocation.check(SCHEMA + 1, SHAPE), Err(AllocationFault::Foreign));
}

fn private_format(agent: usize) -> FrameFormat {
    FrameFormat { schema: SCHEMA, layout: FrameLayout::private(SHAPE, agent).unwrap() }
}

/// The frame of the golden bytes as one of its agents gets it.
fn private_memory(agent: usize) -> ([FrameBlock; 8], FrameHeader) {
    let (whole, header) = (memory(), header());
    let view = FrameView::new(&header, whole.as_bytes(), &format()).unwrap();
    let mut memory = [FrameBlock::zeroed(); 8];
    memory.as_mut_bytes().fill(0xEE);
    let layout = private_format(agent).layout;
    let header = view.write_private(&layout, memory.as_mut_bytes()).unwrap();
    (memory, header)
}

#[test]
fn a_private_frame_has_its_golden_bytes() {
    let (memory, header) = private_memory(0);
    assert_eq!((header.kind, header.len), (2, 512));
    assert_eq!(hex(memory.as_bytes()), PRIVATE_PAYLOAD);
}

#[test]
fn a_private_frame_shows_its_owner_what_a_world_frame_shows_it() {
    let (memory, header) = private_memory(0);
    let view = FrameView::new(&header, memory.as_bytes(), &private_format(0)).unwrap();
    assert_eq!((view.owner(), view.agents(), view.step(), view.absent()), (Some(0), 1, 3, 0b01));
    assert!(view.present().iter().eq([0]) && view.observable(0).iter().eq([0]));
    assert!(view.observable(1).is_empty() && view.available(1).is_empty());
    assert_eq!(view.available(0), [0, 1, 0]);
    let observation = view.observation(0, &view.observable(0));
    assert_eq!((observation.self_index, observation.visible.len()), (0, 1));
    // Its own row twice: the first for itself, the second as what it sees.
    assert!(observation.visible.contains(1));
    assert_eq!(observation.last_actions, [2, 2, 0xFFFF, 0xFFFF]);
    for row in [0, 1] {
        assert_eq!(observation.rows[row * observation.stride..][..5], [0.0, 1.0, 2.0, 3.0, 4.0]);
    }
}

#[test]
fn an_absent_agent_gets_an_empty_private_frame() {
    let (memory, header) = private_memory(1);
    let view = FrameView::new(&header, memory.as_bytes(), &private_format(1)).unwrap();
    assert!(view.present().is_empty() && view.observable(1).is_empty());
    assert!(view.rows().iter().all(|feature| feature.to_bits() == 0));
    assert!(view.shown(1).next().is_none());
}

#[test]
fn a_private_frame_is_nobody_elses() {
    let (memory, header) = private_memory(0);
    let refusal = |format: &FrameFormat| {
        FrameView::new(&header, memory.as_bytes(), format).map(|_| ()).unwrap_err()
    };
    assert_eq!(refusal(&private_format(1)), FrameError::Layout);
    assert_eq!(refusal(&format()), FrameError::Layout);
    // What is private already is not cut again, nor is a frame of another domain.
    let view = FrameView::new(&header, memory.as_bytes(), &private_format(0)).unwrap();
    let mut place = [FrameBlock::zeroed(); 8];
    let layout = private_format(0).layout;
    let cut = view.write_private(&layout, place.as_mut_bytes());
    assert_eq!(cut, Err(FrameError::Layout));
}

/// Every single changed bit is either refused or gives a view within what the agent may be shown.
#[test]
fn no_bit_makes_a_private_view_name_what_does_not_exist() {
    for bit in 0..512 * 8 {
        let (mut memory, header) = private_memory(0);
        memory.as_mut_bytes()[bit / 8] ^= 1 << (bit % 8);
        let Ok(view) = FrameView::new(&header, memory.as_bytes(), &private_format(0)) else {
            continue;
        };
        assert!(view.shown(0).all(|entity| entity < 3), "bit {bit}");
        let everything = view.observation(0, &EntityMask::first(128));
        assert!(everything.visible.iter().all(|row| row > 0 && row < 4), "bit {bit}");
        assert!(view.last_actions().iter().all(|&last| last < 3 || last == 0xFFFF), "bit {bit}");
        assert!(view.entity_task().iter().all(|tasks| tasks >> 2 == 0), "bit {bit}");
    }
}

/// Of the rows of what an agent does not see, its frame has no byte, whatever it sees.
#[test]
fn no_byte_of_an_unseen_row_is_in_a_private_frame() {
    const WIDE: Shape = Shape { agents: 3, entities: 9, tasks: 2, actions: 4, features: 6 };
    let whole = FrameFormat { schema: SCHEMA, layout: FrameLayout::new(WIDE).unwrap() };
    let mark = |entity: usize| 0xA0 + entity as u8;
    let header = FrameHeader { len: whole.layout.payload_bytes() as u32, ..header() };
    let mut memory = [FrameBlock::zeroed(); 16];
    let payload = &mut memory.as_mut_bytes()[..whole.layout.payload_bytes()];
    for bits in 0..1_u64 << 9 {
        let (seen, present) = (EntityMask::from_words(&[bits]), bits.rotate_left(5) & 0x1FF | 2);
        let mut frame = FrameMut::new(payload, whole.layout).unwrap();
        frame.set_present(&EntityMask::from_words(&[present]));
        frame.set_progress(3, TICK, 0);
        frame.set_observable(1, &seen);
        for entity in 0..9 {
            // Four times its mark; a feature that no other field of a frame could show.
            frame.row_mut(entity).fill(f32::from_bits(u32::from_ne_bytes([mark(entity); 4])));
        }
        let view = FrameView::new(&header, payload, &whole).unwrap();
        let layout = FrameLayout::private(WIDE, 1).unwrap();
        let mut own = [FrameBlock::zeroed(); 16];
        own.as_mut_bytes().fill(mark(8));
        let own = &mut own.as_mut_bytes()[..layout.payload_bytes()];
        view.write_private(&layout, own).unwrap();
        for entity in 0..9 {
            let is_seen = seen.contains(entity) && present >> entity & 1 == 1;
            let rows = usize::from(is_seen) + usize::from(entity == 1);
            let shown = own.chunks(4).filter(|feature| **feature == [mark(entity); 4]).count();
            assert_eq!(shown, rows * WIDE.features, "entity {entity}, seen {bits:b}");
        }
    }
}
