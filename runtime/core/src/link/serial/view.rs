//! What some agents see of a frame, as bytes: only the entities that one of them sees, and of their
//! features only those that are not zero.

use super::packet::{FramePacket, Packer, Packet, Unpacker};
use crate::entity_mask::EntityMask;
use crate::limits;
use crate::link::Frame;
use crate::policy::NO_ACTION;
use crate::shape::Shape;
use crate::wire::{FrameFormat, FrameHeader, FrameLayout, FrameMut, FrameView};

const MICROSECOND: u64 = 1_000;
/// Columns of features whose presence one word tells.
const WORD: usize = 64;

/// Longest packet of a frame of this shape, with its checksum.
pub const fn packet_bytes(shape: Shape) -> usize {
    let Shape { agents, entities, actions, features, .. } = shape;
    let set = entities.div_ceil(64) * 10;
    let row = 5 + features.div_ceil(WORD) * 10 + features * 4;
    128 + set + agents * (set + 3 + actions * 3) + entities * row
}

/// Writes what `agents` see of a frame, at `now_ns` of its clock. A frame of another schema is sent
/// without content, for the other end to count. `None`: there is no room, or the frame is unsound.
pub(super) fn write(
    frame: Frame<'_>,
    format: &FrameFormat,
    agents: u64,
    now_ns: u64,
    packet: &mut Packer<'_>,
) -> Option<()> {
    let view = FrameView::new(frame.header, frame.payload, format);
    let is_ours = frame.header.fits(format.schema);
    let view = if is_ours { Some(view.ok()?) } else { None };
    let agents = agents & format.layout.every_agent();
    packet.put(&Packet::Frame(head(frame.header, view.as_ref(), agents, now_ns)))?;
    let Some(view) = view else { return Some(()) };
    let words = format.layout.shape().entities.div_ceil(64);
    let seen = seen_by(&view, agents);
    put_set(packet, &seen, words)?;
    for agent in each(agents) {
        put_set(packet, &view.observable(agent).and(&seen), words)?;
        put_last_action(packet, &view, agent)?;
        for code in view.available(agent) {
            packet.put(code)?;
        }
    }
    for entity in seen.iter() {
        if is_mate(entity, agents, &format.layout) {
            put_last_action(packet, &view, entity)?;
        }
        packet.put(view.entity_task().get(entity)?)?;
        let first = entity.saturating_mul(view.stride());
        let row = view.rows().get(first..)?.get(..format.layout.shape().features)?;
        for columns in row.chunks(WORD) {
            put_columns(packet, columns)?;
        }
    }
    Some(())
}

fn head(
    header: &FrameHeader,
    view: Option<&FrameView<'_>>,
    agents: u64,
    now_ns: u64,
) -> FramePacket {
    let FrameHeader { schema, abi, kind, seq, tick, deadline_ns, flags, generation, .. } = *header;
    let left_us = deadline_ns.saturating_sub(now_ns) / MICROSECOND;
    FramePacket {
        schema,
        abi,
        kind,
        seq,
        tick,
        left_us: (deadline_ns != 0).then_some(left_us),
        flags,
        generation,
        world_term: header.world_term,
        episode: header.episode,
        open_tasks: view.map_or(0, FrameView::open_tasks),
        step: view.map_or(0, FrameView::step),
        decision_tick: view.map_or(0, FrameView::decision_tick),
        absent: view.map_or(0, FrameView::absent),
        agents,
    }
}

/// The present entities that one of `agents` sees, and these agents.
fn seen_by(view: &FrameView<'_>, agents: u64) -> EntityMask {
    let mut seen = EntityMask::EMPTY;
    for agent in each(agents) {
        seen = seen.or(&view.observable(agent));
        seen.insert(agent);
    }
    seen.and(&view.present())
}

fn each(agents: u64) -> impl Iterator<Item = usize> {
    (0..limits::AGENTS).filter(move |agent| agents >> agent & 1 == 1)
}

/// Whether an entity is an agent, but none of `agents`.
fn is_mate(entity: usize, agents: u64, layout: &FrameLayout) -> bool {
    entity < limits::AGENTS && (layout.every_agent() & !agents) >> entity & 1 == 1
}

fn put_last_action(packet: &mut Packer<'_>, view: &FrameView<'_>, agent: usize) -> Option<()> {
    let last_action = view.last_actions().get(agent).copied().unwrap_or(NO_ACTION);
    packet.put(&last_action.wrapping_add(1))
}

fn put_set(packet: &mut Packer<'_>, set: &EntityMask, words: usize) -> Option<()> {
    set.words().iter().take(words).try_for_each(|word| packet.put(word))
}

/// Which of the columns are not zero, and these.
fn put_columns(packet: &mut Packer<'_>, columns: &[f32]) -> Option<()> {
    let is_sent = |feature: &f32| feature.to_bits() != 0;
    let sent = columns.iter().enumerate().filter(|(_, feature)| is_sent(feature));
    packet.put(&sent.fold(0_u64, |sent, (column, _)| sent | 1 << column))?;
    columns.iter().filter(|feature| is_sent(feature)).try_for_each(|feature| packet.put(feature))
}

/// Reads a frame into `payload`, as one whose other agents and entities do not exist. Returns its header,
/// in whose times `started_ns` is when it was sent. `None`: it names what the domain does not have.
pub(super) fn read(
    head: &FramePacket,
    mut packet: Unpacker<'_>,
    layout: &FrameLayout,
    schema: u64,
    started_ns: u64,
    payload: &mut [u8],
) -> Option<FrameHeader> {
    let header = header(head, layout, started_ns);
    if !header.fits(schema) {
        return Some(header);
    }
    let exists = head.agents & !layout.every_agent() == 0
        && head.absent & !layout.every_agent() == 0
        && head.open_tasks & !layout.every_task() == 0;
    let mut frame = FrameMut::new(payload, *layout).ok().filter(|_| exists)?;
    frame.set_open_tasks(head.open_tasks);
    frame.set_progress(head.step, head.decision_tick, head.absent);
    let seen = take_set(&mut packet, layout)?;
    frame.set_present(&seen);
    for agent in each(head.agents) {
        let observable = take_set(&mut packet, layout)?;
        frame.set_observable(agent, &observable);
        frame.set_last_action(agent, take_last_action(&mut packet, layout)?);
        for code in frame.available_mut(agent) {
            *code = packet.take()?;
        }
    }
    for entity in seen.iter() {
        if is_mate(entity, head.agents, layout) {
            frame.set_last_action(entity, take_last_action(&mut packet, layout)?);
        }
        let tasks = packet.take::<u32>().filter(|tasks| tasks & !layout.every_task() == 0)?;
        frame.set_entity_task(entity, tasks);
        for columns in frame.row_mut(entity).chunks_mut(WORD) {
            take_columns(&mut packet, columns)?;
        }
    }
    packet.is_empty().then_some(header)
}

fn header(head: &FramePacket, layout: &FrameLayout, started_ns: u64) -> FrameHeader {
    let deadline = |left_us: u64| started_ns.saturating_add(left_us.saturating_mul(MICROSECOND));
    FrameHeader {
        magic: FrameHeader::MAGIC,
        abi: head.abi,
        kind: head.kind,
        schema: head.schema,
        seq: head.seq,
        tick: head.tick,
        t_ns: started_ns,
        // 0 would mean that there is none.
        deadline_ns: head.left_us.map_or(0, |left_us| deadline(left_us).max(1)),
        len: layout.payload_bytes() as u32,
        flags: head.flags,
        generation: head.generation,
        world_term: head.world_term,
        episode: head.episode,
    }
}

fn take_set(packet: &mut Unpacker<'_>, layout: &FrameLayout) -> Option<EntityMask> {
    let mut words = [0; limits::ENTITIES / 64];
    let needed = layout.shape().entities.div_ceil(64);
    for word in words.iter_mut().take(needed) {
        *word = packet.take()?;
    }
    let set = EntityMask::from_words(&words);
    Some(set).filter(|set| set.and(&layout.every_entity()) == *set)
}

fn take_last_action(packet: &mut Unpacker<'_>, layout: &FrameLayout) -> Option<u16> {
    let last_action = packet.take::<u16>()?.wrapping_sub(1);
    let is_action = usize::from(last_action) < layout.shape().actions;
    Some(last_action).filter(|_| is_action || last_action == NO_ACTION)
}

fn take_columns(packet: &mut Unpacker<'_>, columns: &mut [f32]) -> Option<()> {
    let mut sent: u64 = packet.take()?;
    for feature in columns {
        if sent & 1 == 1 {
            *feature = packet.take()?;
        }
        sent >>= 1;
    }
    // A column that does not exist.
    (sent == 0).then_some(())
}
