//! Sets of cells as bits, and what can be walked to.

use super::world::{EMPTY, World};

/// A set of cells: a number for each row, a bit for each column.
pub(crate) type Board = [u16; 12];

/// The cells whose object a predicate holds for.
pub(crate) fn cells(world: &World, is_meant: impl Fn(u8) -> bool) -> Board {
    let size = usize::from(world.size);
    let mut board = [0; 12];
    for (bits, row) in board.iter_mut().zip(world.cells[..size * size].chunks_exact(size)) {
        for (x, object) in row.iter().enumerate() {
            *bits |= u16::from(is_meant(*object)) << x;
        }
    }
    board
}

/// The agent's cell.
pub(crate) fn agent(world: &World) -> Board {
    let (position, size) = (usize::from(world.position), usize::from(world.size));
    let mut board = [0; 12];
    board[position / size] = 1 << (position % size);
    board
}

/// The cells of a set and their four neighbours.
pub(crate) fn spread(board: &Board) -> Board {
    core::array::from_fn(|y| {
        let row = board[y];
        let above = if y > 0 { board[y - 1] } else { 0 };
        let below = board.get(y + 1).copied().unwrap_or(0);
        row | row << 1 | row >> 1 | above | below
    })
}

pub(crate) fn both(one: &Board, other: &Board) -> Board {
    core::array::from_fn(|y| one[y] & other[y])
}

pub(crate) fn any(one: &Board, other: &Board) -> Board {
    core::array::from_fn(|y| one[y] | other[y])
}

pub(crate) fn count(board: &Board) -> u32 {
    board.iter().map(|row| row.count_ones()).sum()
}

/// The cells that a walk meets which goes on from those that `is_passable` holds for.
pub(crate) fn met(world: &World, is_passable: impl Fn(u8) -> bool) -> Board {
    let passable = cells(world, |object| object == EMPTY || is_passable(object));
    let mut met = agent(world);
    loop {
        let next = any(&met, &spread(&both(&met, &passable)));
        if next == met {
            return met;
        }
        met = next;
    }
}

/// Cells next to which the agent can stand, or stands: whose neighbour is empty or its own.
pub(crate) fn touchable(world: &World) -> Board {
    spread(&any(&cells(world, |object| object == EMPTY), &agent(world)))
}
