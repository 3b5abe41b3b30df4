//! The grid: a board of objects, what the agent carries and how it moves, and what the games on such grids differ in.

use core::fmt::Debug;

use crate::random::{Random, below};

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

/// Most cells of a grid.
pub(crate) const CELLS: usize = 144;
/// Kinds of items that can be carried, the most of any game.
pub(crate) const ITEMS: usize = 12;
/// Things that go back where they were.
pub(crate) const HOMES: usize = 5;

/// The object of a cell without one.
pub(crate) const EMPTY: u8 = 0;
/// The object of the ring around every grid.
pub(crate) const WALL: u8 = 2;

/// A grid, its agent and what it carries. x grows to the right, y down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct World {
    /// Cells of a row, and rows.
    pub size: u8,
    /// `[size * size]`: the object of each cell, row by row; 0 where it is empty.
    pub cells: [u8; CELLS],
    /// Kinds of objects, as bits, that are open or pressed.
    pub open: u16,
    /// The agent's cell.
    pub position: u8,
    /// Where it looks: 0 right, 1 down, 2 left, 3 up.
    pub direction: u8,
    /// How many it carries of each item.
    pub inventory: [u16; ITEMS],
    /// The object that it carries in its hand; 0 for none.
    pub carried: u8,
    /// How the start was drawn, where there are several ways.
    pub case: u8,
    /// Cells that things go back to.
    pub homes: [u8; HOMES],
}

impl World {
    /// An empty grid in its ring of walls.
    pub fn new(size: usize) -> Self {
        let mut cells = [EMPTY; CELLS];
        cells[..size].fill(WALL);
        cells[size * (size - 1)..size * size].fill(WALL);
        for row in cells[size..size * (size - 1)].chunks_exact_mut(size) {
            (row[0], row[size - 1]) = (WALL, WALL);
        }
        Self {
            size: size as u8,
            cells,
            open: 0,
            position: (size + 1) as u8,
            direction: 0,
            inventory: [0; ITEMS],
            carried: EMPTY,
            case: 0,
            homes: [0; HOMES],
        }
    }

    /// The cell at a place.
    pub(crate) fn at(&self, x: usize, y: usize) -> usize {
        y * usize::from(self.size) + x
    }

    /// The object of a cell.
    #[inline]
    pub(crate) fn object(&self, cell: usize) -> u8 {
        self.cells[cell]
    }

    /// Whether objects of a kind are open or pressed.
    #[inline]
    pub(crate) fn is_open(&self, object: u8) -> bool {
        self.open >> object & 1 == 1
    }

    /// How many of an item are carried.
    #[inline]
    pub(crate) fn count(&self, item: u8) -> u16 {
        self.inventory[usize::from(item)]
    }

    pub(crate) fn gain(&mut self, item: u8, count: u16) {
        self.inventory[usize::from(item)] += count;
    }

    pub(crate) fn lose(&mut self, item: u8, count: u16) {
        self.inventory[usize::from(item)] -= count;
    }

    /// The cell before the agent, and the one behind it. The agent never stands on the ring.
    #[inline]
    pub(crate) fn front_and_back(&self) -> [usize; 2] {
        let (position, size) = (usize::from(self.position), usize::from(self.size));
        let sides = [position + 1, position + size, position - 1, position - size];
        let direction = usize::from(self.direction);
        [sides[direction & 3], sides[(direction + 2) & 3]]
    }

    /// Turns, or steps where nothing but an open door is in the way.
    #[inline]
    pub(crate) fn go(
        &mut self,
        action: usize,
        [front, back]: [usize; 2],
        may_enter: fn(u8) -> bool,
    ) {
        let to = match action {
            0 => return self.direction = (self.direction + 3) & 3,
            1 => return self.direction = (self.direction + 1) & 3,
            2 => front,
            _ => back,
        };
        let object = self.object(to);
        if object == EMPTY || may_enter(object) && self.is_open(object) {
            self.position = to as u8;
        }
    }

    /// Puts the agent on an empty one of these cells.
    pub(crate) fn stand_somewhere(
        &mut self,
        cells: impl Iterator<Item = usize> + Clone,
        random: &mut Random,
    ) {
        let empty = cells.filter(|cell| self.cells[*cell] == EMPTY);
        let chosen = below(random, empty.clone().count());
        self.position = empty.clone().nth(chosen).expect("a start has an empty cell") as u8;
        self.direction = below(random, 4) as u8;
    }
}

/// What an action did.
pub type Effect = Option<u8>;

/// The rules of one game.
pub trait Game: Clone + Copy + Debug + Default + Send + Sync + 'static {
    /// Its name, as `--env` takes it.
    const NAME: &'static str;
    /// What it is, in one sentence.
    const ABOUT: &'static str;
    /// Cells of a row, and rows.
    const SIZE: usize;
    /// Kinds of objects by their numbers: empty, agent and wall first.
    const OBJECTS: &'static [&'static str];
    /// States that objects can be in, by their numbers; none where all are alike.
    const STATES: &'static [&'static str];
    /// What can be carried, by its numbers.
    const ITEMS: &'static [&'static str];
    /// Names of the actions.
    const ACTIONS: &'static [&'static str];
    /// All milestones in their order.
    const MILESTONES: &'static [&'static str];
    /// How each milestone shows in what is carried: an item, and by how much its count changes.
    const SIGNS: &'static [(u8, i16)];
    /// Those that a dense reward pays for, as bits.
    const PAID: u16;
    /// Tasks: milestones that can be the last one.
    const TASKS: &'static [&'static str];
    /// How likely each item is to be the one that gets lost, where items can.
    const LOSSES: Option<[u32; ITEMS]>;
    /// Whether an episode is over where no milestone can be had any more.
    const ENDS_IF_IMPOSSIBLE: bool;

    /// Draws a start.
    fn draw(random: &mut Random) -> World;

    /// Takes an action; the milestone that it reached, if any.
    fn act(world: &mut World, action: usize) -> Effect;

    /// The number of the state that objects of a kind are in.
    fn state(world: &World, object: u8) -> u8;

    /// Of the milestones in use, as bits, those that can be next, without another one of them before.
    fn affordances(world: &World, used: u16) -> u16;

    /// Whether one of them can be had.
    fn affords_any(world: &World, used: u16) -> bool {
        Self::affordances(world, used) != 0
    }
}
