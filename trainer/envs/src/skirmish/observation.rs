//! What agents are told of an encounter, and what they may do.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Deserialize;

use super::armies::ARMIES;
use super::battle::{Battle, CAPACITY, NOBODY, Order, Point, Unit, length};
use super::encounter::Encounter;
use super::relations::{Glimpse, Opposed};
use super::scenarios::Scenario;
use super::units::{Book, FULL_ENERGY, MEDIVAC, TYPE_NAMES, TYPES, UnitType};
use crate::battles::WAYS;
use crate::observation::{ActionSet, EntitySet, Observation, members};
use crate::rows::SparseRows;

/// What agents may do besides aiming at somebody: to stop, and to go north, east, south and west.
pub(super) const ORDERS: usize = 1 + WAYS.len();
/// How far an order to go sends a unit, of which it comes about half in a step.
const STRIDE: f32 = 2.0;
/// How far from centre to centre anybody can be aimed at, whatever its weapon.
const AIM: f32 = 6.0;
/// How far agents see, and how far where they defend a base.
const SIGHT: f32 = 9.0;
const WIDE_SIGHT: f32 = 28.0;

/// What is told of any unit behind its side and its type.
const TOLD_NAMES: &str = "health shield energy cooldown x y moved-x moved-y attackers attacks";
const TOLD: usize = 10;
/// What is told of enemies where there are armies.
const ARMY_NAMES: &str = "army-0 army-1 army-2 army-attacks army-since";
/// The column of a row that marks the first army, where there are armies.
pub(super) const FIRST_ARMY: usize = 1 + TYPES + TOLD;
/// Columns of health, shield, and the place.
pub(super) const BODY: [usize; 2] = [1 + TYPES, 2 + TYPES];
pub(super) const PLACE: [usize; 2] = [5 + TYPES, 6 + TYPES];
/// How an agent stands to whom it may aim at.
const PAIR_NAMES: &str = "east north distance within-reach after-it";
const PAIR: usize = 5;
/// What is told of it besides where it has no row that is pointed at.
const LISTED: usize = 3 + TYPES;

/// How actions are aimed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Aim {
    /// Each at one entity, so that a head can point at it.
    #[default]
    Entities,
    /// Each at who is the first, second, ... nearest, of whom an agent's own row has a list.
    Distance,
    /// Each at who has this number, drawn anew in every episode, as published.
    Tags,
}

/// What is observed, and in which columns.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub(super) aim: Aim,
    /// Whether it is told whom enemies are after.
    pub(super) intents: bool,
    pub(super) most: [usize; 2],
    pub(super) has_healers: bool,
    pub(super) is_defence: bool,
}

impl Layout {
    pub(super) fn of(scenario: &Scenario, aim: Aim, intents: bool) -> Self {
        let Scenario { is_defence, .. } = *scenario;
        let (most, has_healers) = (scenario.most(), scenario.has_healers());
        Self { aim, intents, most, has_healers, is_defence }
    }

    /// Actions that are aimed.
    pub(super) fn slots(&self) -> usize {
        let [allies, enemies] = self.most;
        match self.aim {
            Aim::Distance => enemies.max(if self.has_healers { allies } else { 0 }),
            _ if self.has_healers => allies + enemies,
            _ => enemies,
        }
    }

    /// Features of each slot in an agent's own row.
    pub(super) fn slot_features(&self) -> usize {
        match self.aim {
            Aim::Entities => PAIR,
            Aim::Distance => PAIR + LISTED,
            Aim::Tags => 0,
        }
    }

    /// Columns before those of the slots.
    pub(super) fn first_slot(&self) -> usize {
        self.first_tag() + if self.aim == Aim::Tags { self.most.iter().sum() } else { 0 }
    }

    fn first_tag(&self) -> usize {
        FIRST_ARMY + if self.is_defence { ARMIES + 2 } else { 0 }
    }

    pub(super) fn feature_names(&self) -> Vec<String> {
        let words = |list: &'static str| list.split(' ').map(ToString::to_string);
        let mut names: Vec<String> = words("is-enemy").collect();
        names.extend(TYPE_NAMES.map(String::from));
        names.extend(words(TOLD_NAMES));
        names.extend(words(ARMY_NAMES).filter(|_| self.is_defence));
        names.extend(
            (names.len()..self.first_slot()).map(|tag| format!("tag-{}", tag - self.first_tag())),
        );
        for slot in 0..self.slots() {
            let listed = ["health", "shield", "attackers"].into_iter().chain(TYPE_NAMES);
            let told = PAIR_NAMES.split(' ').chain(listed).take(self.slot_features());
            names.extend(told.map(|name| format!("target-{slot}-{name}")));
        }
        names
    }

    /// Most columns of a row that are no zeros: side, type, what is told, army and tag, and all slots.
    pub(super) fn row_entries(&self) -> usize {
        2 + TOLD + 3 + 1 + self.slots() * self.slot_features().min(PAIR + 4)
    }

    /// The entity that stands for a unit.
    pub(super) fn entity(&self, battle: &Battle, unit: usize) -> usize {
        if unit < battle.allies { unit } else { self.most[0] + unit - battle.allies }
    }

    /// The unit that an entity stands for, if there is one.
    pub(super) fn unit(&self, battle: &Battle, entity: usize) -> Option<usize> {
        match entity.checked_sub(self.most[0]) {
            Some(enemy) => Some(battle.allies + enemy).filter(|unit| *unit < battle.count),
            None => Some(entity).filter(|unit| *unit < battle.allies),
        }
    }

    /// Whether a unit sees another one: both live.
    pub(super) fn sees(&self, battle: &Battle, unit: usize, other: usize) -> bool {
        let sight = if self.is_defence { WIDE_SIGHT } else { SIGHT };
        let both_live = battle.units[unit].is_alive() && battle.units[other].is_alive();
        both_live && battle.distance(unit, other) <= sight
    }

    /// Whom each of an agent's slots is about, nobody's where there is none; nearest first where they are ranked.
    fn aimed_at(&self, encounter: &Encounter, agent: usize, slots: &mut [u8; CAPACITY]) {
        let battle = &encounter.battle;
        slots.fill(NOBODY);
        match self.aim {
            Aim::Entities => {
                let first = if self.has_healers { 0 } else { self.most[0] };
                for slot in 0..self.slots() {
                    slots[slot] = self.unit(battle, first + slot).map_or(NOBODY, |unit| unit as u8);
                }
            }
            Aim::Tags => {
                let units = battle.units[..battle.count].iter().zip(0..);
                units.for_each(|(unit, number)| slots[usize::from(unit.tag)] = number);
            }
            Aim::Distance => {
                let is_healer = battle.units[agent].kind == MEDIVAC;
                let foes = if is_healer { 0..battle.allies } else { battle.allies..battle.count };
                let mut ranked = [(0.0, NOBODY); CAPACITY];
                let mut count = 0;
                for foe in foes.filter(|foe| *foe != agent && self.sees(battle, agent, *foe)) {
                    ranked[count] = (battle.distance(agent, foe), foe as u8);
                    count += 1;
                }
                ranked[..count].sort_by(|one, other| one.0.total_cmp(&other.0));
                slots.iter_mut().zip(&ranked[..count]).for_each(|(slot, (_, foe))| *slot = *foe);
            }
        }
    }

    /// The actions that an agent may take.
    pub(super) fn available(&self, encounter: &Encounter, book: &Book, agent: usize) -> ActionSet {
        let battle = &encounter.battle;
        if !battle.units[agent].is_alive() {
            return 1;
        }
        let mut slots = [NOBODY; CAPACITY];
        self.aimed_at(encounter, agent, &mut slots);
        let place = battle.units[agent].place;
        let stays = |way: &Point| {
            [0, 1].into_iter().all(|part| (0.0..=book.side).contains(&(place[part] + way[part])))
        };
        let ways = WAYS.iter().map(stays);
        let aims = slots[..self.slots()].iter().map(|unit| {
            let unit = usize::from(*unit);
            unit < battle.count && can_aim((battle, book), agent, unit)
        });
        let all = core::iter::once(true).chain(ways).chain(aims).enumerate();
        all.fold(0, |set, (action, is_open)| set | ActionSet::from(is_open) << action)
    }

    /// The order that an action of an agent stands for.
    pub(super) fn order(&self, encounter: &Encounter, agent: usize, action: usize) -> Order {
        let unit = &encounter.battle.units[agent];
        let Some(slot) = action.checked_sub(ORDERS) else {
            return match action.checked_sub(1) {
                Some(way) => {
                    Order::Go([0, 1].map(|part| unit.place[part] + STRIDE * WAYS[way][part]))
                }
                None => Order::Stop,
            };
        };
        match self.target(encounter, agent, slot) {
            target if unit.kind == MEDIVAC => Order::Heal(target),
            target => Order::Attack(target),
        }
    }

    /// Whom an agent's slot is about.
    pub(super) fn target(&self, encounter: &Encounter, agent: usize, slot: usize) -> u8 {
        let mut slots = [NOBODY; CAPACITY];
        self.aimed_at(encounter, agent, &mut slots);
        slots[slot]
    }

    /// The action of an agent that is aimed at a unit.
    pub(super) fn action_at(
        &self,
        encounter: &Encounter,
        agent: usize,
        unit: usize,
    ) -> Option<usize> {
        let mut slots = [NOBODY; CAPACITY];
        self.aimed_at(encounter, agent, &mut slots);
        let slot = slots[..self.slots()].iter().position(|other| usize::from(*other) == unit)?;
        Some(ORDERS + slot)
    }

    /// Writes what is to be seen under a symmetry.
    pub(super) fn observe(
        &self,
        (encounter, book): (&Encounter, &Book),
        turn: usize,
        wanted: EntitySet,
        seen: &mut Observation,
    ) {
        let Encounter { battle, armies, .. } = encounter;
        let entity = |unit: usize| self.entity(battle, unit);
        let set = |shows: &dyn Fn(usize) -> bool| {
            (0..battle.count)
                .filter(|unit| shows(*unit))
                .fold(0, |set, unit| set | 1 << entity(unit))
        };
        let allies: EntitySet = (1 << battle.allies) - 1;
        let living = set(&|unit| battle.units[unit].is_alive());
        // Agents keep their numbers, whoever of them is left; of enemies nothing is left.
        seen.present = allies | living;
        seen.absent = (allies & !living) as u64;
        seen.entities = wanted & seen.present;
        let agents = self.most[0];
        seen.observable.clear();
        seen.observable.extend(
            (0..battle.allies)
                .map(|agent| set(&|other| other == agent || self.sees(battle, agent, other))),
        );
        seen.observable.resize(agents, 0);
        seen.available.clear();
        seen.available.extend(
            (0..battle.allies)
                .map(|agent| turned_actions(turn, self.available(encounter, book, agent))),
        );
        seen.available.resize(agents, 1);
        seen.entity_task.clear();
        seen.entity_task.resize(agents + self.most[1], 0);
        for unit in members(seen.present & !allies).filter_map(|thing| self.unit(battle, thing)) {
            let army = battle.units[unit].army;
            seen.entity_task[entity(unit)] = if army == NOBODY { 0 } else { 1 << army };
        }
        seen.open_tasks = armies.open().into();
        seen.rows.clear();
        let attackers = encounter.attackers(self.intents);
        for unit in members(seen.entities).filter_map(|entity| self.unit(battle, entity)) {
            self.write_row((encounter, book), (unit, turn), &attackers, &mut seen.rows);
        }
    }

    /// Writes how each of the wanted units stands to an army; nothing for who is dead.
    pub(super) fn relate(
        &self,
        (encounter, book): (&Encounter, &Book),
        (turn, army): (usize, usize),
        wanted: EntitySet,
        rows: &mut SparseRows,
    ) {
        let battle = &encounter.battle;
        let glimpse = |number: usize| {
            let unit = &battle.units[number];
            let [health, shield, _] = shares(unit, &book.types[unit.kind()]);
            let army = (unit.army != NOBODY).then_some(unit.army.into());
            let place = seen_at(unit, book, turn);
            unit.is_alive().then_some(Glimpse { army, place, body: health + shield })
        };
        let units = (0..battle.count).filter_map(|number| Some((number, glimpse(number)?)));
        let opposed = Opposed::of(units, army);
        let is_shown = |number: &usize| *number < battle.allies || battle.units[*number].is_alive();
        for number in (0..battle.count).filter(is_shown) {
            if wanted >> self.entity(battle, number) & 1 == 0 {
                continue;
            }
            if let (Some(opposed), Some(unit)) = (opposed, glimpse(number)) {
                let columns = opposed.relation(number, &unit).into_iter().enumerate();
                columns.for_each(|(column, value)| rows.push_unless_zero(column, value));
            }
            rows.end_row();
        }
    }

    fn write_row(
        &self,
        (encounter, book): (&Encounter, &Book),
        (number, turn): (usize, usize),
        attackers: &[u8; CAPACITY],
        rows: &mut SparseRows,
    ) {
        let Encounter { battle, armies, .. } = encounter;
        let unit = &battle.units[number];
        let is_enemy = number >= battle.allies;
        rows.push_unless_zero(0, f32::from(u8::from(is_enemy)));
        rows.push(1 + unit.kind(), 1.0);
        let start = 1 + TYPES;
        if unit.is_alive() {
            let nature = &book.types[unit.kind()];
            let [x, y] = seen_at(unit, book, turn);
            let moved = [0, 1].map(|part| (unit.place[part] - unit.before[part]) / STRIDE);
            let [moved_x, moved_y] = turned(turn, moved);
            let [health, shield, energy] = shares(unit, nature);
            let cooldown = if nature.period > 0.0 { unit.cooldown / nature.period } else { 0.0 };
            let attacks = match unit.order {
                Order::Attack(_) | Order::Heal(_) => true,
                _ => is_enemy && self.intents && unit.target != NOBODY,
            };
            let attackers = f32::from(attackers[number]) / 4.0;
            let attacks = f32::from(u8::from(attacks));
            let told = [
                health,
                shield,
                energy,
                cooldown.max(0.0),
                x,
                y,
                moved_x,
                moved_y,
                attackers,
                attacks,
            ];
            for (column, value) in told.into_iter().enumerate() {
                rows.push_unless_zero(start + column, value);
            }
        }
        let army = usize::from(unit.army);
        if let Some(own) = armies.list.get(army) {
            rows.push(FIRST_ARMY + army, 1.0);
            rows.push_unless_zero(FIRST_ARMY + ARMIES, f32::from(u8::from(own.attacks)));
            rows.push_unless_zero(FIRST_ARMY + ARMIES + 1, f32::from(own.since) / 20.0);
        }
        if self.aim == Aim::Tags {
            rows.push(self.first_tag() + usize::from(unit.tag), 1.0);
        } else if !is_enemy && unit.is_alive() && self.slot_features() > 0 {
            self.write_slots((encounter, book), (number, turn), attackers, rows);
        }
        rows.end_row();
    }

    fn write_slots(
        &self,
        (encounter, book): (&Encounter, &Book),
        (agent, turn): (usize, usize),
        attackers: &[u8; CAPACITY],
        rows: &mut SparseRows,
    ) {
        let battle = &encounter.battle;
        let mut slots = [NOBODY; CAPACITY];
        self.aimed_at(encounter, agent, &mut slots);
        let reach = book.types[battle.units[agent].kind()].range;
        for (slot, other) in slots[..self.slots()].iter().map(|unit| usize::from(*unit)).enumerate()
        {
            if other >= battle.count || other == agent || !self.sees(battle, agent, other) {
                continue;
            }
            let way = battle.way(agent, other);
            let [east, north] = turned(turn, way.map(|part| part / SIGHT));
            let unit = &battle.units[other];
            let is_near = battle.gap(book, agent, other) <= reach;
            let is_after = self.intents && usize::from(unit.target) == agent;
            let flag = |is_so| f32::from(u8::from(is_so));
            let pair = [east, north, length(way) / SIGHT, flag(is_near), flag(is_after)];
            let start = self.first_slot() + slot * self.slot_features();
            for (column, value) in pair.into_iter().enumerate() {
                rows.push_unless_zero(start + column, value);
            }
            if self.aim == Aim::Distance {
                let [health, shield, _] = shares(unit, &book.types[unit.kind()]);
                let listed = [health, shield, f32::from(attackers[other]) / 4.0];
                for (column, value) in listed.into_iter().enumerate() {
                    rows.push_unless_zero(start + PAIR + column, value);
                }
                rows.push(start + PAIR + 3 + unit.kind(), 1.0);
            }
        }
    }
}

/// Whether an agent may attack or heal a unit.
fn can_aim((battle, book): (&Battle, &Book), agent: usize, other: usize) -> bool {
    let [kind, aimed] = [agent, other].map(|unit| battle.units[unit].kind());
    let is_fit = if other < battle.allies {
        agent != other && book.can_heal(kind, aimed)
    } else {
        book.can_hit(kind, aimed)
    };
    is_fit && battle.units[other].is_alive() && battle.distance(agent, other) <= AIM
}

impl Encounter {
    /// How many of the other side's units were told to attack each, and of allies, where intents are told, how many are after
    /// it.
    fn attackers(&self, intents: bool) -> [u8; CAPACITY] {
        let mut attackers = [0; CAPACITY];
        for (number, unit) in self.battle.units[..self.battle.count].iter().enumerate() {
            let attacked = match unit.order {
                _ if !unit.is_alive() => NOBODY,
                Order::Attack(other) => other,
                _ if intents && number >= self.battle.allies => unit.target,
                _ => NOBODY,
            };
            if let Some(count) = attackers.get_mut(usize::from(attacked)) {
                *count += 1;
            }
        }
        attackers
    }
}

/// Where a unit is, from -1 to 1 on both axes, under a symmetry.
fn seen_at(unit: &Unit, book: &Book, turn: usize) -> Point {
    let half = book.side / 2.0;
    turned(turn, unit.place.map(|part| (part - half) / half))
}

/// Life, shield and energy as shares of what there can be.
pub(super) fn shares(unit: &Unit, nature: &UnitType) -> [f32; 3] {
    let shield = if nature.shield > 0.0 { unit.shield / nature.shield } else { 0.0 };
    [unit.life / nature.life, shield, unit.energy / FULL_ENERGY]
}

/// A way under one of the eight symmetries of the square: bit 0 turns east and west round, bit 1 north and south, and then
/// bit 2 swaps both.
fn turned(turn: usize, [x, y]: Point) -> Point {
    let (x, y) = (if turn & 1 == 1 { -x } else { x }, if turn & 2 == 2 { -y } else { y });
    if turn & 4 == 4 { [y, x] } else { [x, y] }
}

/// The number that an action has under a symmetry.
pub(super) fn turned_action(turn: usize, action: usize) -> usize {
    match action {
        1..ORDERS => {
            let way = turned(turn, WAYS[action - 1]);
            1 + WAYS.iter().position(|known| *known == way).unwrap_or(action - 1)
        }
        _ => action,
    }
}

fn turned_actions(turn: usize, actions: ActionSet) -> ActionSet {
    let moves = (1..ORDERS)
        .fold(0, |set, action| set | (actions >> action & 1) << turned_action(turn, action));
    actions & !((1 << ORDERS) - 2) | moves
}
