//! Encounters as bytes: the layout's version, and then what `serde` makes of them.

use alloc::format;
use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use super::armies::Armies;
use super::battle::{Battle, CAPACITY, NOBODY, Order, Unit};
use super::encounter::{Encounter, Outcome};
use super::units::Book;
use crate::bytes::LAYOUT;
use crate::environment::StateError;

/// What is told before the units.
#[derive(Serialize, Deserialize)]
struct Head {
    allies: u8,
    count: u8,
    armies: Armies,
    order_seed: u16,
    steps: u32,
    episode_return: f64,
    outcome: Outcome,
}

/// Most bytes of an encounter of so many units. Numbers of two and four bytes take one more at most.
pub(super) const fn state_bytes(units: usize) -> usize {
    1 + size_of::<Head>() + 2 + units * size_of::<Unit>()
}

impl Encounter {
    /// Adds its bytes.
    pub(super) fn write(&self, bytes: &mut Vec<u8>) {
        let Self { battle: Battle { allies, count, units }, armies, .. } = self;
        let head = Head {
            allies: *allies as u8,
            count: *count as u8,
            armies: armies.clone(),
            order_seed: self.order_seed,
            steps: self.steps,
            episode_return: self.episode_return,
            outcome: self.outcome,
        };
        bytes.push(LAYOUT);
        let written = postcard::to_extend(&head, core::mem::take(bytes));
        let written = units[..*count]
            .iter()
            .fold(written, |bytes, unit| bytes.and_then(|bytes| postcard::to_extend(unit, bytes)));
        *bytes = written.unwrap_or_default();
    }

    /// Reads what [`write`](Self::write) wrote, of teams of at most these sizes.
    pub(super) fn read(bytes: &[u8], book: &Book, most: [usize; 2]) -> Result<Self, StateError> {
        let (&found, bytes) = bytes
            .split_first()
            .ok_or(StateError::Length { found: 0, wanted: state_bytes(most[0] + most[1]) })?;
        if found != LAYOUT {
            return Err(StateError::Version { found, wanted: LAYOUT });
        }
        let broken =
            |_: postcard::Error| StateError::Impossible("its bytes end or say nothing".into());
        let (head, mut rest) = postcard::take_from_bytes::<Head>(bytes).map_err(broken)?;
        let [allies, count] = [head.allies, head.count].map(usize::from);
        let sizes = [allies, count.saturating_sub(allies)];
        if sizes.contains(&0) || sizes[0] > most[0] || sizes[1] > most[1] {
            return Err(StateError::Impossible(format!("{sizes:?} units meet")));
        }
        let mut battle = Battle { allies, count, units: [Unit::default(); CAPACITY] };
        for unit in &mut battle.units[..count] {
            (*unit, rest) = postcard::take_from_bytes(rest).map_err(broken)?;
        }
        let Head { armies, order_seed, steps, episode_return, outcome, .. } = head;
        let is_sound = rest.is_empty()
            && episode_return.is_finite()
            && armies.is_sound()
            && battle.units[..count].iter().all(|unit| is_unit(unit, (book, count)))
            && has_armies(&battle, &armies);
        if !is_sound {
            return Err(StateError::Impossible("a unit or an army is none".into()));
        }
        Ok(Self { battle, armies, order_seed, steps, episode_return, outcome })
    }
}

/// Whether a unit can be one of so many.
fn is_unit(unit: &Unit, (book, count): (&Book, usize)) -> bool {
    let Unit { target, victim, attacker, place: [x, y], life, shield, energy, .. } = *unit;
    let (goal, aimed_at) = match unit.order {
        Order::Stop => ([0.0; 2], 0),
        Order::Go(goal) | Order::Advance(goal) => (goal, 0),
        Order::Attack(other) | Order::Heal(other) => ([0.0; 2], other),
    };
    let numbers = [x, y, unit.before[0], unit.before[1], goal[0], goal[1], energy];
    let numbers = numbers.into_iter().chain([unit.cooldown, unit.speed]);
    let exists = |other: u8| usize::from(other) < count;
    book.types.get(unit.kind()).is_some_and(|nature| {
        (0.0..=nature.life).contains(&life) && (0.0..=nature.shield).contains(&shield)
    }) && numbers.into_iter().all(f32::is_finite)
        && exists(aimed_at)
        && (unit.flight == 0 || exists(victim))
        && [target, victim, attacker].into_iter().all(|other| other == NOBODY || exists(other))
}

/// Whether each enemy belongs to an army where there are any, and nobody else.
fn has_armies(battle: &Battle, armies: &Armies) -> bool {
    battle.units[..battle.count].iter().enumerate().all(|(number, unit)| {
        let is_member = number >= battle.allies && armies.count > 0;
        if is_member { usize::from(unit.army) < armies.count } else { unit.army == NOBODY }
    }) && battle.units[..battle.count].iter().all(|unit| usize::from(unit.tag) < CAPACITY)
}
