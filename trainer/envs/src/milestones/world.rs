//! What one grid holds, and how the agent moves on it.

use crate::random::{Random, below};

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
