//! Maps: where walls, doors, pits, treasures and starts are, what agents see from where, and maps that are drawn.

use alloc::string::String;
use alloc::vec::Vec;
use alloc::{format, vec};
use core::fmt;

use crate::random::{Random, below, shuffle, unit};

/// Most agents.
pub const MAX_AGENTS: usize = 4;
/// Most kinds of treasures.
pub const MAX_TREASURES: usize = 8;

/// Rows and columns of every map.
pub const SIDE: usize = 20;
/// Cells of every map; cell `row * SIDE + column`.
pub const CELLS: usize = SIDE * SIDE;

/// The maze of tasks 1 to 3, with starts and treasures of the largest team.
pub(super) const MAZE: &str = include_str!("maze.txt");
/// Characters of maps.
pub(super) const WALL: u8 = b'#';
pub(super) const PIT: u8 = b'!';
const FREE: u8 = b' ';
pub(super) const FIRST_DOOR: u8 = b'$';
/// Doors that differ.
pub(super) const DOORS: u8 = 12;
/// What cells are shut for that never open.
const NEVER: u8 = u8::MAX;
/// Where there is none.
pub(super) const NONE: u8 = u8::MAX;

/// What an agent sees from a cell, beside others: at most one of nine things.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Look {
    /// Column of the wall or pit, or none.
    pub(super) column: u8,
    /// The pit, if it is one.
    pub(super) pit: u8,
}

/// A map for a team.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Map {
    rows: Vec<u8>,
    /// By cells: the number of finished tiers from which it can be entered.
    opens: Vec<u8>,
    /// By cells: the treasure there.
    treasures: Vec<u8>,
    looks: Vec<Look>,
    pub(super) starts: Vec<u16>,
    pits: Vec<u16>,
    /// By treasures and cells: steps to it.
    distances: Vec<Vec<u16>>,
}

/// Cells next to a cell, by actions; the last is itself.
pub(super) fn neighbours(cell: usize) -> [usize; 5] {
    [cell - SIDE, cell + SIDE, cell - 1, cell + 1, cell]
}

impl Map {
    /// Reads a map of 20 rows: `#` walls, `!` pits, `1` to `4` where agents start, `A` to `H` treasures, and doors from
    /// `$` on. Starts and treasures beyond so many are left out.
    ///
    /// # Errors
    /// Something is missing or cannot be.
    pub fn parse(text: &str, agents: usize, treasures: usize) -> Result<Self, MapError> {
        let lines: Vec<&[u8]> = text.lines().map(str::as_bytes).collect();
        if lines.len() != SIDE || lines.iter().any(|line| line.len() != SIDE) {
            return Err(MapError(format!("a map has {SIDE} rows of {SIDE} characters")));
        }
        let mut rows = lines.concat();
        let (mut starts, mut places) = (vec![None; agents], vec![None; treasures]);
        let mut opens = vec![0; CELLS];
        for (cell, character) in rows.iter_mut().enumerate() {
            let is_edge = [0, SIDE - 1].iter().any(|end| [cell / SIDE, cell % SIDE].contains(end));
            match *character {
                WALL => opens[cell] = NEVER,
                _ if is_edge => return Err(MapError("a map has walls all around".into())),
                PIT | FREE => {}
                own @ b'1'..=b'4' => set(&mut starts, own - b'1', cell, character),
                own @ b'A'..=b'H' => set(&mut places, own - b'A', cell, character),
                door if (FIRST_DOOR..FIRST_DOOR + DOORS).contains(&door) => {
                    opens[cell] = door - FIRST_DOOR + 1;
                }
                other => return Err(MapError(format!("`{}` means nothing", char::from(other)))),
            }
        }
        let missing = |what: &str| MapError(format!("a map lacks {what}"));
        let starts: Option<Vec<u16>> = starts.into_iter().collect();
        let places: Option<Vec<u16>> = places.into_iter().collect();
        let starts = starts.ok_or_else(|| missing("the start of an agent"))?;
        let places = places.ok_or_else(|| missing("a treasure"))?;
        let mut treasures = vec![NONE; CELLS];
        (0..).zip(&places).for_each(|(number, cell)| treasures[usize::from(*cell)] = number);
        let pits = (0..).zip(&rows).filter(|(_, it)| **it == PIT).map(|(cell, _)| cell).collect();
        let mut map =
            Self { rows, opens, treasures, looks: vec![], starts, pits, distances: vec![] };
        map.looks = (0..CELLS).map(|cell| map.look(cell)).collect();
        map.distances = places.iter().map(|cell| map.distances_to(usize::from(*cell))).collect();
        Ok(map)
    }

    /// The characters, row by row.
    pub fn rows(&self) -> &[u8] {
        &self.rows
    }

    /// Where agents start.
    pub fn starts(&self) -> &[u16] {
        &self.starts
    }

    /// The cells of the pits, in their order.
    pub fn pits(&self) -> &[u16] {
        &self.pits
    }

    /// Kinds of treasures.
    pub fn treasures(&self) -> usize {
        self.distances.len()
    }

    /// The treasure in a cell.
    #[inline]
    pub(super) fn treasure_at(&self, cell: u16) -> Option<u8> {
        let treasure = self.treasures[usize::from(cell)];
        (treasure != NONE).then_some(treasure)
    }

    /// What is seen from a cell.
    #[inline]
    pub(super) fn seen_from(&self, cell: u16) -> Look {
        self.looks[usize::from(cell)]
    }

    /// Whether an agent can be in a cell once so many tiers are finished.
    #[inline]
    pub(super) fn is_open(&self, cell: u16, tiers: u8) -> bool {
        self.opens[usize::from(cell)] <= tiers
    }

    /// Where an action leads.
    #[inline]
    pub(super) fn moved(&self, cell: u16, action: u8, tiers: u8) -> u16 {
        const STRIDE: u16 = SIDE as u16;
        let ahead = match action {
            0 => cell - STRIDE,
            1 => cell + STRIDE,
            2 => cell - 1,
            3 => cell + 1,
            _ => cell,
        };
        if self.is_open(ahead, tiers) { ahead } else { cell }
    }

    /// The action of a shortest way to a treasure, whatever doors there are.
    pub(super) fn way(&self, cell: usize, treasure: usize) -> u8 {
        let distance = |cell: usize| self.distances[treasure][cell];
        let nearest = (0..).zip(neighbours(cell)).min_by_key(|(_, next)| distance(*next));
        nearest.map_or(super::STAY, |(action, _)| action)
    }

    /// The pit that an agent stands on, else the first wall or pit to the right, below, to the left, above.
    fn look(&self, cell: usize) -> Look {
        let pit = |cell: usize| self.pits.iter().position(|pit| usize::from(*pit) == cell);
        if self.rows[cell] == WALL {
            return Look { column: NONE, pit: NONE };
        }
        if let Some(own) = pit(cell) {
            return Look { column: 4, pit: own as u8 };
        }
        let [up, down, left, right, _] = neighbours(cell);
        for (side, next) in (0..).zip([right, down, left, up]) {
            if self.rows[next] == WALL {
                return Look { column: side, pit: NONE };
            }
            if let Some(pit) = pit(next) {
                return Look { column: 5 + side, pit: pit as u8 };
            }
        }
        Look { column: NONE, pit: NONE }
    }

    fn distances_to(&self, goal: usize) -> Vec<u16> {
        let mut distances = vec![u16::MAX; CELLS];
        distances[goal] = 0;
        let (mut queue, mut place) = (vec![goal], 0);
        while let Some(&cell) = queue.get(place) {
            for next in neighbours(cell) {
                if self.opens[next] != NEVER && distances[next] == u16::MAX {
                    distances[next] = distances[cell] + 1;
                    queue.push(next);
                }
            }
            place += 1;
        }
        distances
    }
}

/// Notes where something is, of which there are so many; what is more than that leaves a free cell.
fn set(places: &mut [Option<u16>], number: u8, cell: usize, character: &mut u8) {
    match places.get_mut(usize::from(number)) {
        Some(place) => *place = Some(cell as u16),
        None => *character = FREE,
    }
}

/// Why a text is no map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapError(String);

impl fmt::Display for MapError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl core::error::Error for MapError {}

const _: () = assert!(MAX_AGENTS == 4 && MAX_TREASURES == 8);

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
        shuffle(self, list);
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
