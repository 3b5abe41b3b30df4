//! Rules that allocate agents to armies, and a script that fights them.

use super::armies::ARMIES;
use super::battle::{CAPACITY, each};
use super::encounter::Encounter;
use super::observation::Layout;
use super::units::{Book, MEDIVAC, TYPES};
use crate::battles::heading;
use crate::decisions::UNASSIGNED;
use crate::random::{Random, generator, member, shuffle};
use crate::spec::Rule;

/// The rules as command lines name them, the usual one first.
pub(super) const RULES: &[Rule] = &[
    Rule::new(
        "dynamic",
        "One agent after the other: an army that attacks, that has a unit of its type left to match, that nobody has, that is larger",
    ),
    Rule::new("matching", "The same, whether an army attacks or not"),
    Rule::new("random", "Every agent any army that is left"),
];

/// The rule that draws.
const RANDOM: usize = 2;

/// What rules know of armies.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Muster {
    /// Units of each type.
    pub(super) units: [[i8; TYPES]; ARMIES],
    pub(super) attacks: [bool; ARMIES],
    /// Those that are left, as bits.
    pub(super) open: u32,
}

impl Muster {
    /// Of an encounter. The dead count too, so that the living keep their armies.
    fn of(Encounter { battle, armies, .. }: &Encounter) -> Self {
        let attacks = armies.list.each_ref().map(|army| army.attacks);
        let mut muster = Self { attacks, open: armies.open(), ..Self::default() };
        for enemy in &battle.units[battle.allies..battle.count] {
            if let Some(units) = muster.units.get_mut(usize::from(enemy.army)) {
                units[enemy.kind()] += 1;
            }
        }
        muster
    }

    /// Writes an army for each of these agents, told with their types, one after the other.
    pub(super) fn allocate(
        self,
        rule: usize,
        agents: impl Iterator<Item = (usize, usize)>,
        random: &mut Random,
        allocation: &mut [u8],
    ) {
        let Self { units: mut unmatched, attacks, open } = self;
        let mut surplus = unmatched.map(|army| army.iter().sum::<i8>());
        let mut is_taken = [false; ARMIES];
        for (agent, kind) in agents {
            let worth = |army: &usize| {
                let attacks = rule == 0 && attacks[*army];
                (attacks, unmatched[*army][kind] > 0, !is_taken[*army], surplus[*army])
            };
            let army = if rule == RANDOM {
                member(random, open.into())
            } else {
                // Of equals the first.
                (0..ARMIES).rev().filter(|army| open >> army & 1 == 1).max_by_key(worth)
            };
            let Some(army) = army else { return };
            allocation[agent] = army as u8;
            is_taken[army] = true;
            surplus[army] -= 1;
            unmatched[army][kind] = (unmatched[army][kind] - 1).max(0);
        }
    }
}

/// Writes for every agent its army, in an order that the episode has drawn.
pub(super) fn allocate(
    rule: usize,
    encounter: &Encounter,
    random: &mut Random,
    allocation: &mut [u8],
) {
    let battle = &encounter.battle;
    allocation.fill(UNASSIGNED);
    let mut order: [usize; CAPACITY] = core::array::from_fn(|agent| agent);
    let order = &mut order[..battle.allies];
    if rule != RANDOM {
        shuffle(&mut generator(encounter.order_seed.into()), order);
    }
    let agents = order.iter().map(|agent| (*agent, battle.units[*agent].kind()));
    Muster::of(encounter).allocate(rule, agents, random, allocation);
}

/// Who shoots attacks the nearest enemy of its army, or of all where none of that is left, and goes there first; who heals
/// stays with the others and heals who has the smallest share of its life left.
pub(super) fn scripted(
    (encounter, layout, book): (&Encounter, &Layout, &Book),
    allocation: &[u8],
    actions: &mut [u16],
) {
    let battle = &encounter.battle;
    let [allies, enemies] = battle.living();
    for (agent, action) in actions.iter_mut().enumerate().take(battle.allies) {
        let available = layout.available(encounter, book, agent);
        let army = allocation.get(agent).copied().unwrap_or(UNASSIGNED);
        let own = battle.army(army.into());
        let is_healer = battle.units[agent].kind == MEDIVAC;
        let foes = if own == 0 { enemies } else { own };
        let others = if is_healer { allies & !(1 << agent) } else { foes };
        let need = |other: usize| {
            if is_healer { life(encounter, book, other) } else { battle.distance(agent, other) }
        };
        let aims = each(others).filter_map(|other| {
            let aim = layout.action_at(encounter, agent, other)?;
            (available >> aim & 1 == 1 && (!is_healer || need(other) < 1.0))
                .then_some((need(other), aim))
        });
        let aim = aims.min_by(|one, other| one.0.total_cmp(&other.0)).map(|(_, aim)| aim);
        let nearest = each(others).min_by(|one, other| {
            battle.distance(agent, *one).total_cmp(&battle.distance(agent, *other))
        });
        let walk = nearest.map(|other| 1 + heading(battle.way(agent, other)));
        let wish = aim.or(walk).filter(|action| available >> action & 1 == 1);
        *action = wish.unwrap_or(0) as u16;
    }
}

fn life(encounter: &Encounter, book: &Book, unit: usize) -> f32 {
    let unit = &encounter.battle.units[unit];
    unit.life / book.types[unit.kind()].life
}
