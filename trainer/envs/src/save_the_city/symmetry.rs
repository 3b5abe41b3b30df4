//! The eight symmetries of the square, exact on states and actions.

use super::grid::DIRECTIONS;
use super::state::{AgentState, BuildingState, SIDE};

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
