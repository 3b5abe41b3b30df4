//! Maps of the Flip-Task: eight winding paths out of a free middle, a treasure at the end of each.

use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;

use super::map::{CELLS, FIRST_DOOR, SIDE, neighbours};
use crate::random::{Random, below, unit};

/// Paths of a map.
pub(super) const PATHS: usize = 8;
/// Chance that a cell of a path is a pit.
const PITS: f64 = 0.15;
/// Least length of the shortest path, as a share of the longest.
const ALIKE: f64 = 0.8;

/// Where the numbers of a map come from: a generator, or a recording.
pub trait Draw {
    /// A whole number below a bound.
    fn below(&mut self, bound: usize) -> usize;
    /// A number from 0 to 1.
    fn unit(&mut self) -> f64;
    /// Puts a list into a random order.
    fn shuffle<T: Copy>(&mut self, list: &mut [T]);
}

impl Draw for Random {
    fn below(&mut self, bound: usize) -> usize {
        below(self, bound)
    }

    fn unit(&mut self) -> f64 {
        unit(self)
    }

    fn shuffle<T: Copy>(&mut self, list: &mut [T]) {
        (1..list.len()).rev().for_each(|last| list.swap(last, below(self, last + 1)));
    }
}

/// A map for so many agents as text, whose paths are about as long; maps that are not are drawn anew.
pub fn draw_map(agents: usize, draw: &mut impl Draw) -> String {
    loop {
        let mut drawing = Drawing::new(agents, draw);
        drawing.dig(agents, draw);
        if drawing.place_treasures() {
            return drawing.text();
        }
    }
}

/// A way on: a cell to dig, and the cell that it is reached from.
type Way = (usize, usize);

/// A map that is being drawn.
struct Drawing {
    cells: Vec<u8>,
    /// By cells: the path that it belongs to, and steps from the middle.
    paths: Vec<Option<(usize, u32)>>,
    ring: Vec<usize>,
}

impl Drawing {
    /// A free middle with starts, all else walls.
    fn new(agents: usize, draw: &mut impl Draw) -> Self {
        let width = (1..).find(|width| width * width > agents && 2 * width > PATHS).unwrap_or(SIDE);
        let (first, last) = ((SIDE - width) / 2, (SIDE - width) / 2 + width - 1);
        let side = first..=last;
        let middle: Vec<usize> = side
            .clone()
            .flat_map(|row| side.clone().map(move |column| row * SIDE + column))
            .collect();
        let mut cells = vec![b'#'; CELLS];
        middle.iter().for_each(|cell| cells[*cell] = b' ');
        let is_edge =
            |cell: &usize| [first, last].iter().any(|end| [cell / SIDE, cell % SIDE].contains(end));
        let ring = middle.iter().copied().filter(is_edge).collect();
        let mut left = middle;
        for agent in 0..agents {
            let start = left.remove(draw.below(left.len()));
            cells[start] = b'1' + agent as u8;
        }
        Self { cells, paths: vec![None; CELLS], ring }
    }

    /// The ways on from a cell: above, left, below, right.
    fn ways(&self, from: usize) -> impl Iterator<Item = Way> + '_ {
        let [up, down, left, right, _] = neighbours(from);
        [up, left, down, right].map(|to| (to, from)).into_iter().filter(|way| self.can_dig(*way))
    }

    /// Whether a cell inside the map is a wall among walls, but for where it is reached from.
    fn can_dig(&self, (to, from): Way) -> bool {
        let is_edge = [0, SIDE - 1].iter().any(|end| [to / SIDE, to % SIDE].contains(end));
        !is_edge
            && self.cells[to] == b'#'
            && neighbours(to)[..4].iter().all(|next| *next == from || self.cells[*next] == b'#')
    }

    /// Digs all paths in turn, a cell at a time, until none can go on.
    fn dig(&mut self, agents: usize, draw: &mut impl Draw) {
        let bases: Vec<Way> = self.ring.iter().flat_map(|cell| self.ways(*cell)).collect();
        let mut stacks = [(); PATHS].map(|()| {
            let mut own = bases.clone();
            draw.shuffle(&mut own);
            own
        });
        while stacks.iter().any(|stack| !stack.is_empty()) {
            for (path, stack) in stacks.iter_mut().enumerate() {
                while let Some(way) = stack.pop() {
                    if self.can_dig(way) {
                        self.dig_cell(way, (path, path / agents), stack, draw);
                        break;
                    }
                }
            }
        }
    }

    fn dig_cell(
        &mut self,
        (cell, from): Way,
        (path, tier): (usize, usize),
        stack: &mut Vec<Way>,
        draw: &mut impl Draw,
    ) {
        let before = self.paths[from].map(|(_, distance)| distance);
        self.paths[cell] = Some((path, before.unwrap_or(0) + 1));
        self.cells[cell] = if draw.unit() < PITS { b'!' } else { b' ' };
        let mut ways: Vec<Way> = self.ways(cell).collect();
        draw.shuffle(&mut ways);
        if before.is_none() {
            stack.clear();
            if tier > 0 {
                self.cells[cell] = FIRST_DOOR + tier as u8 - 1;
            }
        }
        stack.append(&mut ways);
    }

    /// Puts a treasure into the farthest cell of each path; false where one has none, or lengths differ too much.
    fn place_treasures(&mut self) -> bool {
        let mut lengths = Vec::new();
        for path in 0..PATHS {
            let own = (0..CELLS).filter_map(|cell| {
                let (of, distance) = self.paths[cell]?;
                (of == path).then_some((distance, core::cmp::Reverse(cell)))
            });
            let Some((distance, core::cmp::Reverse(cell))) = own.max() else { return false };
            self.cells[cell] = b'A' + path as u8;
            lengths.push(f64::from(distance));
        }
        let longest = lengths.iter().copied().fold(0.0, f64::max);
        lengths.iter().all(|length| *length >= ALIKE * longest)
    }

    fn text(&self) -> String {
        let characters = self.cells.chunks(SIDE).flat_map(|row| row.iter().copied().chain([b'\n']));
        characters.map(char::from).collect()
    }
}
