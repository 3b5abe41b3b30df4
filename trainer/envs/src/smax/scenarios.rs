//! Which teams meet in a set, and where they start.

use alloc::vec;
use alloc::vec::Vec;

use super::battle::{Battle, SIDE};
use super::units::TYPES;
use crate::battles::{CAPACITY, Point, Team, meeting};
use crate::random::{Random, below, chance, unit};

/// Letters of types in the names of teams; published ones have no zerglings.
pub(super) const LETTERS: [char; TYPES] = ['m', 'M', 's', 'z', 'l', 'h'];

/// Which teams meet.
#[derive(Clone, Debug)]
pub(super) struct Roster {
    /// Allies and enemies that an episode is drawn among.
    pub(super) teams: Vec<[Team; 2]>,
    /// Whether types and places are drawn, the same for both sides; then teams say sizes alone.
    is_drawn: bool,
}

/// The names of sets that lists show; there are more teams.
pub(super) const SETS: &str = "2s3z 3m 8m 25m 3s5z 5m_vs_6m 10m_vs_11m 27m_vs_30m 3s5z_vs_3s6z 3s_vs_5z \
    6h_vs_8z smacv2_5_units smacv2_10_units smacv2_20_units 3-8sz 3-8sz+1";

impl Roster {
    /// The teams that a name stands for, none where it stands for none that fit.
    pub(super) fn named(name: &str) -> Option<Self> {
        let drawn = name.strip_prefix("smacv2_").and_then(|name| name.strip_suffix("_units"));
        let teams = match (name, drawn) {
            ("3-8sz", _) => tasks().map(|team| [team.clone(), team]).collect(),
            ("3-8sz+1", _) => tasks().flat_map(harder).collect(),
            (_, Some(units)) => {
                let team = vec![0; units.parse().ok().filter(|units| *units <= CAPACITY)?];
                vec![[team.clone(), team]]
            }
            _ => vec![meeting(name, &LETTERS)?],
        };
        let roster = Self { teams, is_drawn: drawn.is_some() };
        let [allies, enemies] = roster.most();
        (allies.min(enemies) > 0 && allies + enemies <= CAPACITY).then_some(roster)
    }

    /// Units of the largest teams.
    pub(super) fn most(&self) -> [usize; 2] {
        [0, 1].map(|side| self.teams.iter().map(|teams| teams[side].len()).max().unwrap_or(0))
    }

    /// Whether these teams may meet.
    pub(super) fn has(&self, teams: &[Team; 2]) -> bool {
        let [allies, enemies] = teams;
        let is_mirror = allies == enemies && allies.len() == self.teams[0][0].len();
        if self.is_drawn { is_mirror } else { self.teams.contains(teams) }
    }

    /// Draws teams and the places where they start, before they push each other away.
    pub(super) fn draw(&self, random: &mut Random) -> Battle {
        let [allies, enemies] = &self.teams[below(random, self.teams.len())];
        let mut battle = Battle::of(allies, enemies);
        if !self.is_drawn {
            for (unit, ally) in (0..battle.count).map(|unit| (unit, unit < battle.allies)) {
                let x = if ally { SIDE / 4.0 } else { SIDE * 0.75 };
                battle.units[unit].place = around([x, SIDE / 2.0], random);
            }
            return battle;
        }
        let mut kinds = [0; CAPACITY];
        let kinds = &mut kinds[..battle.allies];
        kinds.fill_with(|| below(random, TYPES) as u8);
        battle = Battle::of(kinds, kinds);
        if chance(random, 0.5) {
            surround(&mut battle, random);
        } else {
            reflect(&mut battle, random);
        }
        battle
    }
}

/// Allies anywhere on the left, enemies as in a mirror.
fn reflect(battle: &mut Battle, random: &mut Random) {
    let (allies, enemies) = battle.units[..battle.count].split_at_mut(battle.allies);
    for (ally, enemy) in allies.iter_mut().zip(enemies) {
        let [x, y] = [SIDE / 2.0, SIDE].map(|most| most * unit(random) as f32);
        (ally.place, enemy.place) = ([x, y], [SIDE - x, y]);
    }
}

/// One team in the middle, each of the other's units at one of four points between it and the corners. Some may lie beyond
/// the border, where they die at once.
fn surround(battle: &mut Battle, random: &mut Random) {
    let middle = [SIDE / 2.0; 2];
    let allies_inside = chance(random, 0.5);
    let corners = [[0.0, 0.0], [0.0, SIDE], [SIDE, 0.0], [SIDE, SIDE]];
    let points = corners.map(|corner: Point| {
        let share = unit(random) as f32;
        corner.map(|part| share * middle[0] + (1.0 - share) * part)
    });
    for (number, unit) in battle.units[..battle.count].iter_mut().enumerate() {
        let is_inside = (number < battle.allies) == allies_inside;
        let centre = if is_inside { middle } else { points[below(random, points.len())] };
        unit.place = around(centre, random);
    }
}

/// Draws a place near another one.
fn around(place: Point, random: &mut Random) -> Point {
    place.map(|part| part + 4.0 * unit(random) as f32 - 2.0)
}

/// Teams of 3 to 8 stalkers and zealots.
fn tasks() -> impl Iterator<Item = Team> {
    (3..=8).flat_map(|size| (0..=size).map(move |zealots| sorted(size - zealots, zealots)))
}

fn sorted(stalkers: usize, zealots: usize) -> Team {
    [vec![STALKER; stalkers], vec![ZEALOT; zealots]].concat()
}

/// The types of units of the tasks.
const STALKER: u8 = 2;
const ZEALOT: u8 = 3;

/// A team against the same with a stalker more, and with a zealot more.
fn harder(team: Team) -> [[Team; 2]; 2] {
    let stalkers = team.iter().filter(|kind| **kind == STALKER).count();
    let zealots = team.len() - stalkers;
    let enemies = [sorted(stalkers + 1, zealots), sorted(stalkers, zealots + 1)];
    enemies.map(|enemies| [team.clone(), enemies])
}
