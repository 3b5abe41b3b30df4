//! The map: which cells are free, which building a cell lies beside, and the eight symmetries of the square.

use super::state::{AgentState, BuildingState, NO_BUILDING, SIDE};

const WALL: usize = 2;
const COLUMNS: usize = SIDE as usize + 2 * WALL;

/// Displacements of north, east, south and west: action 1 + i moves by one, action 5 + i by two.
pub(super) const DIRECTIONS: [(i8, i8); 4] = [(0, 1), (1, 0), (0, -1), (-1, 0)];

/// The free cells, one bit each, inside a wall that is two cells thick.
///
/// The wall is as thick as the longest move, so that no destination needs a bounds check.
#[derive(Clone, Copy, Debug)]
pub(super) struct FreeCells([u32; COLUMNS]);

impl FreeCells {
    /// A map without any object.
    pub(super) fn all() -> Self {
        let mut columns = [0; COLUMNS];
        columns[WALL..COLUMNS - WALL].fill(0xFFFF << WALL);
        Self(columns)
    }

    /// Puts an object on a cell of the map.
    pub(super) fn occupy(&mut self, x: u8, y: u8) {
        self.0[usize::from(x) + WALL] &= !(1 << (usize::from(y) + WALL));
    }

    /// 1 where the cell at this displacement, at most two cells, is on the map and free.
    pub(super) fn free_at(&self, x: u8, y: u8, dx: i8, dy: i8) -> u16 {
        let column = (usize::from(x) + WALL).wrapping_add_signed(dx.into());
        let row = (usize::from(y) + WALL).wrapping_add_signed(dy.into());
        (self.0[column] >> row & 1) as u16
    }

    /// Whether the cell is on the map and free.
    pub(super) fn is_free(&self, x: u8, y: u8) -> bool {
        self.free_at(x, y, 0, 0) == 1
    }
}

/// What stays as it is for an episode: the buildings' cells and the cells beside them.
#[derive(Clone, Debug)]
pub(super) struct Ground {
    /// The cells without a building.
    pub(super) free: FreeCells,
    beside: [u8; SIDE as usize * SIDE as usize],
}

impl Ground {
    /// The map of these buildings, or the two indices of buildings that lie too close together.
    pub(super) fn new(buildings: &[BuildingState]) -> Result<Self, (usize, usize)> {
        let mut ground = Self::empty();
        for (index, building) in buildings.iter().enumerate() {
            for (earlier, other) in buildings[..index].iter().enumerate() {
                let apart = building.x.abs_diff(other.x).max(building.y.abs_diff(other.y));
                if apart < 3 {
                    return Err((earlier, index));
                }
            }
            ground.free.occupy(building.x, building.y);
            for (x, y) in neighbours(building.x, building.y) {
                ground.beside[cell(x, y)] = index as u8;
            }
        }
        Ok(ground)
    }

    /// The map without any building.
    pub(super) fn empty() -> Self {
        Self { free: FreeCells::all(), beside: [NO_BUILDING; 256] }
    }

    /// The building orthogonally beside a cell, or [`NO_BUILDING`].
    pub(super) fn building_beside(&self, x: u8, y: u8) -> u8 {
        self.beside[cell(x, y)]
    }
}

/// The cells where buildings may stand, x-major.
pub(super) fn sites(spacing: u8) -> impl Iterator<Item = (u8, u8)> {
    let step = usize::from(spacing.max(1));
    (1..SIDE).step_by(step).flat_map(move |x| (1..SIDE).step_by(step).map(move |y| (x, y)))
}

/// The cells where a team may start: of the smallest centred square with enough cells off the sites.
///
/// The whole map's cells are given where no square has enough.
pub(super) fn agent_candidates(spacing: u8, agents: usize) -> impl Iterator<Item = (u8, u8)> {
    let margin = (0..SIDE / 2)
        .rev()
        .find(|&margin| off_sites(spacing, margin).count() >= agents)
        .unwrap_or(0);
    off_sites(spacing, margin)
}

fn off_sites(spacing: u8, margin: u8) -> impl Iterator<Item = (u8, u8)> {
    let on_line = move |coordinate: u8| coordinate % spacing.max(1) == 1;
    let range = margin..SIDE - margin;
    range
        .clone()
        .flat_map(move |x| range.clone().map(move |y| (x, y)))
        .filter(move |&(x, y)| !(on_line(x) && on_line(y)))
}

/// Number of a cell, x-major.
pub(super) fn cell(x: u8, y: u8) -> usize {
    usize::from(x) * usize::from(SIDE) + usize::from(y)
}

/// The orthogonal neighbours on the map.
pub(super) fn neighbours(x: u8, y: u8) -> impl Iterator<Item = (u8, u8)> {
    DIRECTIONS.into_iter().filter_map(move |(dx, dy)| {
        let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
        (x < SIDE && y < SIDE).then_some((x, y))
    })
}

/// A turn or reflection of the map. The rules look the same from every side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symmetry {
    mirror_x: bool,
    mirror_y: bool,
    transpose: bool,
}

impl Symmetry {
    /// All eight; the first changes nothing.
    pub const ALL: [Self; 8] = {
        let mut all = [Self { mirror_x: false, mirror_y: false, transpose: false }; 8];
        let mut index = 0;
        while index < 8 {
            all[index] = Self {
                mirror_x: index & 1 != 0,
                mirror_y: index & 2 != 0,
                transpose: index & 4 != 0,
            };
            index += 1;
        }
        all
    };

    /// Where a cell goes: mirrored first, then transposed.
    pub const fn cell(self, x: u8, y: u8) -> (u8, u8) {
        let x = if self.mirror_x { SIDE - 1 - x } else { x };
        let y = if self.mirror_y { SIDE - 1 - y } else { y };
        if self.transpose { (y, x) } else { (x, y) }
    }

    /// The number that an action has on the changed map; other numbers stay as they are.
    pub const fn action(self, action: u16) -> u16 {
        if action == 0 || action > 8 {
            return action;
        }
        let index = action as usize - 1;
        let far = index / 4 * 4;
        (1 + far + self.direction(index % 4)) as u16
    }

    /// An availability mask on the changed map.
    pub const fn available(self, available: u16) -> u16 {
        let turned = &TURNED_DIRECTIONS[self.index()];
        let near = turned[(available >> 1 & 15) as usize] as u16;
        let far = turned[(available >> 5 & 15) as usize] as u16;
        available & !MOVES | near << 1 | far << 5
    }

    /// Its place in [`ALL`](Self::ALL).
    const fn index(self) -> usize {
        self.mirror_x as usize | (self.mirror_y as usize) << 1 | (self.transpose as usize) << 2
    }

    /// An agent on the changed map.
    pub const fn agent(self, agent: &AgentState) -> AgentState {
        let (x, y) = self.cell(agent.x, agent.y);
        AgentState { x, y, available: self.available(agent.available), ..*agent }
    }

    /// A building on the changed map.
    pub const fn building(self, building: &BuildingState) -> BuildingState {
        let (x, y) = self.cell(building.x, building.y);
        BuildingState { x, y, ..*building }
    }

    /// What undoes this.
    pub const fn inverse(self) -> Self {
        if self.transpose {
            Self { mirror_x: self.mirror_y, mirror_y: self.mirror_x, transpose: true }
        } else {
            self
        }
    }

    /// The index that a direction (north, east, south, west) has on the changed map.
    const fn direction(self, index: usize) -> usize {
        let (dx, dy) = DIRECTIONS[index];
        let dx = if self.mirror_x { -dx } else { dx };
        let dy = if self.mirror_y { -dy } else { dy };
        let (dx, dy) = if self.transpose { (dy, dx) } else { (dx, dy) };
        match (dx, dy) {
            (0, 1) => 0,
            (1, 0) => 1,
            (0, -1) => 2,
            _ => 3,
        }
    }
}

/// Bits of the moves in an availability mask: near ones from 1, far ones from 5.
const MOVES: u16 = 0x1FE;

/// For each symmetry the directions, as bits, that four bits of directions become.
const TURNED_DIRECTIONS: [[u8; 16]; 8] = {
    let mut turned = [[0; 16]; 8];
    let mut place = 0;
    while place < 8 * 16 * 4 {
        let (symmetry, set, direction) = (place / 64, place / 4 % 16, place % 4);
        let bit = (set >> direction & 1) as u8;
        turned[symmetry][set] |= bit << Symmetry::ALL[symmetry].direction(direction);
        place += 1;
    }
    turned
};
