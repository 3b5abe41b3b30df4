//! What is told of a battle: a row for each unit, or as published a vector for each agent and one of the whole state.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::battle::{ATTACK, Battle, SIDE};
use super::scenarios::Roster;
use super::units::{HEALTH, PERIOD, RuleBook, Rules, SIGHT, TYPE_NAMES, TYPES};
use crate::rows::SparseRows;

/// What is told of any unit, in rows and in vectors.
const TOLD_NAMES: &str = "health x y moved-x moved-y attacked cooldown";
const TOLD: usize = 7;
/// What a vector tells of another unit, and of the agent itself; the latter is told of each unit in the whole state.
pub(super) const OTHER: usize = TOLD + TYPES;
const OWN: usize = 4 + TYPES;
/// Most columns of a row that are no zeros, pairs apart: which unit it is, on which side, of which type, and what is told,
/// as nobody moves and attacks, or moves both ways.
pub(super) const ROW_ENTRIES: usize = 3 + TOLD - 2;
/// Features of a pair: how far away the enemy is to the east and to the north, in sights.
pub(super) const PAIR: usize = 2;

/// The columns of rows, of teams of at most these sizes.
pub(super) fn row_names([allies, enemies]: [usize; 2], rules: &Rules) -> Vec<String> {
    let names = |what: &'static str, count| (0..count).map(move |unit| format!("{what}-{unit}"));
    let own = ["is-enemy", TYPE_NAMES, TOLD_NAMES].into_iter().flat_map(str::split_whitespace);
    let pair = |enemy| ["east", "north"].map(|way| format!("enemy-{enemy}-{way}"));
    let pairs = if rules.pairs { enemies } else { 0 };
    let units = names("ally", allies).chain(names("enemy", enemies));
    units.chain(own.map(String::from)).chain((0..pairs).flat_map(pair)).collect()
}

/// The columns of vectors, in a battle of so many units. Of two units the whole state has more numbers than agents see.
pub(super) fn vector_names(units: usize) -> Vec<String> {
    let words = |lists: [&'static str; 2]| lists.into_iter().flat_map(str::split_whitespace);
    let others = (1..units).flat_map(|other| {
        words([TOLD_NAMES, TYPE_NAMES]).map(move |name| format!("other-{other}-{name}"))
    });
    let own = words(["health x y cooldown", TYPE_NAMES]).map(String::from);
    let mut names: Vec<String> = others.chain(own).collect();
    names.resize(names.len().max((OWN + 2) * units), "of-the-state".into());
    names
}

impl Battle {
    /// What is told of a unit at a place, with attacks as shares of the last action's number, or both these and cooldowns
    /// as they are.
    fn told(&self, unit: usize, [x, y]: [f32; 2], last_action: Option<usize>) -> [f32; TOLD] {
        let unit = &self.units[unit];
        let health = f32::from(unit.health) / f32::from(HEALTH[unit.kind()]);
        let [moved_x, moved_y] = unit.moved();
        let attack = if unit.order >= ATTACK { unit.order.into() } else { 0.0 };
        let (attack, cooldown) = match last_action {
            Some(last) => {
                let waits = unit.cooldown / PERIOD[unit.kind()];
                (attack / last as f32, waits.clamp(0.0, 1.0))
            }
            None => (attack, unit.cooldown),
        };
        [health, x, y, moved_x, moved_y, attack, cooldown]
    }

    /// Number of the last of a unit's actions.
    fn last_action(&self, unit: usize) -> usize {
        usize::from(ATTACK) + self.foes(unit) - 1
    }

    /// Adds the row of a unit that is an entity of this number.
    pub(super) fn write_row(
        &self,
        (rules, roster): (&Rules, &Roster),
        unit: usize,
        entity: usize,
        rows: &mut SparseRows,
    ) {
        let [allies, enemies] = roster.most();
        let (side, is_enemy) = (allies + enemies, unit >= self.allies);
        rows.push(entity, 1.0);
        rows.push_unless_zero(side, f32::from(u8::from(is_enemy)));
        rows.push(side + 1 + self.units[unit].kind(), 1.0);
        if self.units[unit].is_alive() {
            // Where sizes of teams differ, numbers of actions do not.
            let is_fixed = roster.teams.len() == 1;
            let last = if is_fixed { self.foes(unit) } else { enemies } + usize::from(ATTACK) - 1;
            let place = self.units[unit].place.map(|part| part / SIDE);
            let mut told = self.told(unit, place, Some(last));
            if is_enemy && !rules.see_enemy_actions {
                told[3..6].fill(0.0);
            }
            let start = side + 1 + TYPES;
            let told = told.into_iter().enumerate();
            told.for_each(|(column, value)| rows.push_unless_zero(start + column, value));
            if rules.pairs && !is_enemy {
                self.write_pairs(unit, start + TOLD, rows);
            }
        }
        rows.end_row();
    }

    fn write_pairs(&self, unit: usize, start: usize, rows: &mut SparseRows) {
        let sight = SIGHT[self.units[unit].kind()];
        for enemy in (self.allies..self.count).filter(|enemy| self.sees(unit, *enemy)) {
            let pair = start + PAIR * (enemy - self.allies);
            let [east, north] = self.way(unit, enemy).map(|part| part / sight);
            rows.push_unless_zero(pair, east);
            rows.push_unless_zero(pair + 1, north);
        }
    }

    /// Writes the published vector of a unit of either team into zeros.
    pub(super) fn write_vector(&self, rules: &Rules, unit: usize, vector: &mut [f32]) {
        if !self.units[unit].is_alive() {
            return;
        }
        let scale = |unit| (rules.rules == RuleBook::Current).then(|| self.last_action(unit));
        let (is_ally, others) = (unit < self.allies, self.count - 1);
        let (blocks, own) = vector.split_at_mut(OTHER * others);
        for (place, block) in blocks.chunks_exact_mut(OTHER).enumerate() {
            // Enemies count all units backwards. Both leave themselves out.
            let place = if is_ally { place } else { others - 1 - place };
            let other = place + usize::from(place >= unit);
            if self.sees(unit, other) {
                let sight = SIGHT[self.units[unit].kind()];
                let way = self.way(unit, other).map(|part| part / sight);
                block[..TOLD].copy_from_slice(&self.told(other, way, scale(other)));
                if is_ally != (other < self.allies) && !rules.see_enemy_actions {
                    block[3..6].fill(0.0);
                }
                block[TOLD + self.units[other].kind()] = 1.0;
            }
        }
        let place = self.units[unit].place.map(|part| part / SIDE);
        self.write_own(unit, self.told(unit, place, scale(unit)), own);
    }

    /// Writes the published vector of the whole state into zeros.
    pub(super) fn write_state(&self, vector: &mut [f32]) {
        for (number, unit) in self.units[..self.count].iter().enumerate() {
            if unit.is_alive() {
                let told = self.told(number, unit.place, None);
                self.write_own(number, told, &mut vector[OWN * number..]);
            }
            let is_enemy = u8::from(number >= self.allies);
            vector[OWN * self.count + number] = is_enemy.into();
            vector[(OWN + 1) * self.count + number] = unit.kind.into();
        }
    }

    fn write_own(&self, unit: usize, told: [f32; TOLD], vector: &mut [f32]) {
        let [health, x, y, .., cooldown] = told;
        vector[..4].copy_from_slice(&[health, x, y, cooldown]);
        vector[4 + self.units[unit].kind()] = 1.0;
    }
}
