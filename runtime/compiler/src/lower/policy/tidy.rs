//! What is left of a policy's steps once nobody reads some of them, and where values stand that need not last.
//!
//! Values get blocks of the arena, one behind the other, while steps are written. Here steps are taken out whose results
//! nobody reads, a result stands where its value stood if that was read for the last time, and blocks share floats if
//! they are never needed at once.

use std::collections::BTreeSet;

use sortie_core::internal::ops::{Op, Place};

/// Floats that a block starts at a multiple of.
const ALIGN: u32 = 16;

/// Tidies steps whose values stand in `blocks`, in the order of their offsets; returns the floats of the arena.
pub(super) fn tidy(ops: &mut Vec<Op>, blocks: &[Place]) -> u32 {
    remove_unread(ops, blocks);
    let mut owners: Vec<usize> = (0..blocks.len()).collect();
    let mut spans = spans(ops, blocks);
    for (index, op) in ops.iter().enumerate() {
        let Some((from, to)) = in_place(op) else { continue };
        let (Some(from_block), Some(to_block)) = (block_of(blocks, from), block_of(blocks, to))
        else {
            continue;
        };
        let from_owner = owners[from_block];
        let starts =
            (from.offset, to.offset) == (blocks[from_block].offset, blocks[to_block].offset);
        let fits = starts && room(blocks[to_block]) <= room(blocks[from_owner]);
        let last = spans[from_owner].is_some_and(|(_, last)| last == index);
        let first = spans[to_block].is_some_and(|(first, _)| first == index);
        let apart = others(op).iter().all(|read| block_of(blocks, *read) != Some(from_block));
        if fits && last && first && apart && from.len == to.len {
            let end = spans[to_block].map_or(index, |(_, last)| last);
            spans[from_owner] = spans[from_owner].map(|(first, _)| (first, end));
            spans[to_block] = None;
            owners[to_block] = from_owner;
        }
    }
    let (offsets, floats) = placed(blocks, &spans);
    for op in ops {
        for place in places(op) {
            if let Some(block) = block_of(blocks, *place) {
                let within = place.offset - blocks[block].offset;
                place.offset = offsets[owners[block]] + within;
            }
        }
    }
    floats
}

/// Takes out steps whose results nobody reads.
fn remove_unread(ops: &mut Vec<Op>, blocks: &[Place]) {
    let next = ops.iter().filter_map(|op| match op {
        Op::State(state) => block_of(blocks, state.to),
        _ => None,
    });
    let mut needed: BTreeSet<usize> = next.collect();
    let mut kept = Vec::new();
    for mut op in std::mem::take(ops).into_iter().rev() {
        let (reads, writes) = reads_and_writes(&mut op);
        let blocks_of = |places: Vec<&mut Place>| -> Vec<usize> {
            places.iter().filter_map(|place| block_of(blocks, **place)).collect()
        };
        let (reads, writes) = (blocks_of(reads), blocks_of(writes));
        let stays = matches!(op, Op::Input(_) | Op::State(_) | Op::Output(_) | Op::MaskedArgmax(_));
        if stays || writes.iter().any(|block| needed.contains(block)) {
            needed.extend(reads);
            kept.push(op);
        }
    }
    kept.reverse();
    *ops = kept;
}

/// The first and the last step that needs each block; none where no step does.
fn spans(ops: &mut [Op], blocks: &[Place]) -> Vec<Option<(usize, usize)>> {
    let mut spans: Vec<Option<(usize, usize)>> = vec![None; blocks.len()];
    let end = ops.len();
    for (index, op) in ops.iter_mut().enumerate() {
        let is_state = matches!(op, Op::State(_));
        let is_end = matches!(op, Op::Output(_) | Op::MaskedArgmax(_));
        for place in places(op) {
            let Some(block) = block_of(blocks, *place) else { continue };
            // States stand there before the first step; outputs are read behind the last.
            let first = if is_state { 0 } else { index };
            let last = if is_end { end } else { index };
            let span = spans[block].get_or_insert((first, last));
            *span = (span.0.min(first), span.1.max(last));
        }
    }
    for op in ops {
        let Op::State(state) = op else { continue };
        let Some(block) = block_of(blocks, state.to) else { continue };
        spans[block] = spans[block].map(|(first, _)| (first, end));
    }
    spans
}

/// Offsets that keep blocks apart which are needed at once, the largest first, each as low as possible.
fn placed(blocks: &[Place], spans: &[Option<(usize, usize)>]) -> (Vec<u32>, u32) {
    let mut order: Vec<usize> = (0..blocks.len()).filter(|block| spans[*block].is_some()).collect();
    order.sort_by_key(|block| std::cmp::Reverse(blocks[*block].len));
    let mut offsets = vec![0; blocks.len()];
    let mut done: Vec<usize> = Vec::new();
    let mut floats = 0;
    for block in order {
        let mut taken: Vec<(u32, u32)> = (done.iter())
            .filter(|other| meet(spans[block], spans[**other]))
            .map(|other| (offsets[*other], offsets[*other] + room(blocks[*other])))
            .collect();
        taken.sort_unstable();
        let mut offset = 0;
        for (start, end) in taken {
            if offset + room(blocks[block]) > start {
                offset = offset.max(end);
            }
        }
        offsets[block] = offset;
        floats = floats.max(offset + room(blocks[block]));
        done.push(block);
    }
    (offsets, floats)
}

fn meet(one: Option<(usize, usize)>, other: Option<(usize, usize)>) -> bool {
    one.zip(other).is_some_and(|(one, other)| one.0 <= other.1 && other.0 <= one.1)
}

/// Floats from a block's start to where the next may start.
fn room(block: Place) -> u32 {
    block.len.next_multiple_of(ALIGN)
}

/// The block that a place starts in.
fn block_of(blocks: &[Place], place: Place) -> Option<usize> {
    let after = blocks.partition_point(|block| block.offset <= place.offset);
    after.checked_sub(1)
}

/// The value and the result of a step that can write where it reads.
fn in_place(op: &Op) -> Option<(Place, Place)> {
    match op {
        Op::Map(op) => Some((op.from, op.to)),
        Op::Combine(op) => Some((op.left, op.to)),
        Op::Softmax(op) => Some((op.from, op.to)),
        Op::Normalise(op) => Some((op.from, op.to)),
        _ => None,
    }
}

/// What such a step reads besides.
fn others(op: &Op) -> Vec<Place> {
    match op {
        Op::Combine(op) => vec![op.right],
        _ => Vec::new(),
    }
}

/// All places of a step.
fn places(op: &mut Op) -> Vec<&mut Place> {
    let (mut reads, writes) = reads_and_writes(op);
    reads.extend(writes);
    reads
}

/// The places that a step reads, and those that it writes; rooms of its own are among the latter.
fn reads_and_writes(op: &mut Op) -> (Vec<&mut Place>, Vec<&mut Place>) {
    match op {
        Op::Input(op) => (vec![], vec![&mut op.to]),
        Op::State(op) => (vec![], vec![&mut op.from, &mut op.to]),
        Op::Constant(op) => (vec![], vec![&mut op.to]),
        Op::Map(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::Combine(op) => (vec![&mut op.left, &mut op.right], vec![&mut op.to]),
        Op::Select(op) => (vec![&mut op.condition, &mut op.yes, &mut op.no], vec![&mut op.to]),
        Op::Arrange(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::Reduce(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::Softmax(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::Normalise(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::Multiply(op) => (vec![&mut op.left, &mut op.right], vec![&mut op.to]),
        Op::Dense(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::DenseRows(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::Int8Dense(op) => (vec![&mut op.from], vec![&mut op.to, &mut op.quantised]),
        Op::LookUp(op) => {
            let tables = (!op.constant.is_set()).then_some(&mut op.tables);
            ([&mut op.indices].into_iter().chain(tables).collect(), vec![&mut op.to])
        }
        Op::GruCell(op) => {
            (vec![&mut op.input, &mut op.recurrent, &mut op.state], vec![&mut op.to])
        }
        Op::LstmCell(op) => (
            vec![&mut op.input, &mut op.recurrent, &mut op.cell],
            vec![&mut op.to, &mut op.cell_to],
        ),
        Op::ConvolvePatches(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::FoldPatches(op) => (vec![&mut op.from], vec![&mut op.to]),
        Op::Int8ConvolvePatches(op) => (vec![&mut op.from], vec![&mut op.to, &mut op.quantised]),
        Op::Output(op) => (vec![&mut op.from], vec![]),
        Op::MaskedArgmax(op) => (vec![&mut op.from], vec![]),
        // No policy has others.
        _ => (vec![], vec![]),
    }
}

#[cfg(test)]
mod tests;
