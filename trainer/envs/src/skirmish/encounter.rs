//! An episode between steps: the battle, the armies, and what it has come to.

use serde::{Deserialize, Serialize};

use super::armies::{ARMIES, Armies, Fate, is_armed};
use super::battle::{Battle, CAPACITY, Order, UnitSet};
use super::units::Book;
use crate::battles::Team;
use crate::observation::members;
use crate::random::{Random, below, shuffle};

/// What a unit that dies, and a victory, is rewarded with before all is divided.
pub(super) const DEATH: f64 = 10.0;
pub(super) const VICTORY: f64 = 200.0;
/// Ticks of a step.
const TICKS: usize = 8;

/// How an episode ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Outcome {
    #[default]
    Open,
    Won,
    /// All died, or none of them is armed.
    Killed,
    /// An army reached the base.
    Infiltrated,
}

/// What a step brought, before it is scaled.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Gains {
    /// What enemies lost, army by army; without armies all of it is the first one's.
    pub(super) armies: [f64; ARMIES],
    /// What allies lost, army by army: to that of the enemy who was nearest at last.
    pub(super) own: [f64; ARMIES],
    /// The armies whose fate is new.
    pub(super) changed: u32,
}

/// An episode between steps.
#[derive(Clone, Debug)]
pub(super) struct Encounter {
    pub(super) battle: Battle,
    pub(super) armies: Armies,
    /// Draws in which order rules allocate agents.
    pub(super) order_seed: u16,
    pub(super) steps: u32,
    pub(super) episode_return: f64,
    pub(super) outcome: Outcome,
}

impl Encounter {
    /// Before it begins.
    pub(super) fn of(battle: Battle) -> Self {
        Self {
            battle,
            armies: Armies::default(),
            order_seed: 0,
            steps: 0,
            episode_return: 0.0,
            outcome: Outcome::Open,
        }
    }

    /// Draws what is to be drawn once all are in their places, and gives enemies their first orders.
    pub(super) fn begin(&mut self, book: &Book, random: &mut Random) {
        let battle = &mut self.battle;
        self.order_seed = below(random, 1 << 16) as u16;
        if self.armies.count == 0 {
            let allies = &battle.units[..battle.allies];
            let sum = allies
                .iter()
                .fold([0.0, 0.0], |[x, y], ally| [x + ally.place[0], y + ally.place[1]]);
            let goal = sum.map(|part| part / battle.allies as f32);
            let enemies = &mut battle.units[battle.allies..battle.count];
            enemies.iter_mut().for_each(|enemy| enemy.order = Order::Advance(goal));
        } else {
            // Who has not been told to attack yet stands where it is, and fights whom it meets.
            for enemy in battle.allies..battle.count {
                battle.units[enemy].order = Order::Advance(battle.units[enemy].place);
            }
            self.armies.command((battle, book), random);
        }
        battle.units.iter_mut().for_each(|unit| unit.before = unit.place);
    }

    /// Gives both teams numbers of their own for this episode, of at most so many allies and enemies.
    pub(super) fn tag(&mut self, [allies, enemies]: [usize; 2], random: &mut Random) {
        let mut numbers: [u8; CAPACITY] = core::array::from_fn(|number| number as u8);
        shuffle(random, &mut numbers[..enemies]);
        shuffle(random, &mut numbers[enemies..enemies + allies]);
        let (allies, enemies) = (numbers[enemies..].iter(), numbers[..enemies].iter());
        let (own, others) = self.battle.units.split_at_mut(self.battle.allies);
        let tagged = own.iter_mut().zip(allies).chain(others.iter_mut().zip(enemies));
        tagged.for_each(|(unit, tag)| unit.tag = *tag);
    }

    /// The types of both teams.
    pub(super) fn teams(&self) -> [Team; 2] {
        let (allies, enemies) = self.battle.units[..self.battle.count].split_at(self.battle.allies);
        [allies, enemies].map(|team| team.iter().map(|unit| unit.kind).collect())
    }

    /// Plays a step by the orders that all have.
    pub(super) fn play(&mut self, book: &Book, random: &mut Random) -> Gains {
        let battle = &mut self.battle;
        let count = battle.count;
        let bodies: [f32; CAPACITY] = battle.units.each_ref().map(|unit| unit.life + unit.shield);
        battle.units.iter_mut().for_each(|unit| unit.before = unit.place);
        (0..TICKS).for_each(|_| battle.tick(book, random));
        self.steps += 1;
        let mut gains = Gains::default();
        for (unit, body) in bodies.iter().enumerate().take(count).filter(|(_, body)| **body > 0.0) {
            let now = &battle.units[unit];
            let lost =
                f64::from(body - now.life - now.shield) + if now.is_alive() { 0.0 } else { DEATH };
            let is_ally = unit < battle.allies;
            let enemy = if is_ally { battle.nearest_enemy(unit) } else { unit };
            // Without armies all of it is the first one's.
            let army = usize::from(battle.units[enemy].army);
            let list = if is_ally { &mut gains.own } else { &mut gains.armies };
            list[if army < ARMIES { army } else { 0 }] += lost;
        }
        gains.changed = self.armies.settle((battle, book));
        self.outcome = self.judge();
        if self.outcome == Outcome::Open {
            self.armies.command((&mut self.battle, book), random);
        }
        gains
    }

    fn judge(&self) -> Outcome {
        let armed = |living: UnitSet| {
            members(living.into()).any(|unit| is_armed(self.battle.units[unit].kind))
        };
        match self.battle.living().map(armed) {
            _ if self.armies.list.iter().any(|army| army.fate == Fate::Infiltrated) => {
                Outcome::Infiltrated
            }
            [false, _] => Outcome::Killed,
            [true, false] => Outcome::Won,
            [true, true] => Outcome::Open,
        }
    }
}
