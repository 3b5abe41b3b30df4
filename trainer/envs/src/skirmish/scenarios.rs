//! Which teams meet in a set, and where they start.

use alloc::format;
use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;
use core::f32::consts::TAU;

use super::armies::{ARMIES, Armies, is_armed};
use super::battle::{Battle, CAPACITY, Point, length};
use super::encounter::{DEATH, Encounter, VICTORY};
use super::units::{Book, COLOSSUS, MARAUDER, MARINE, MEDIVAC, STALKER, TYPES, UnitType, ZEALOT};
use crate::battles::{Team, meeting, meeting_name};
use crate::random::{Random, below, generator, unit};

/// Letters of types in names of teams; the fourth is what a medivac is called besides, a dropship.
const LETTERS: [char; TYPES] = ['c', 'M', 'm', 'd', 's', 'z'];

/// The names of sets that lists show; there are more teams.
pub(super) const SETS: &str = "3-8sz 3-8csz 3-8MMM 3-8m 2s3z 3s5z 6-8sz-symmetric \
    6-8sz-disadvantage 6-8MMM-symmetric 6-8MMM-disadvantage";

/// Which teams meet, and how.
#[derive(Clone, Debug)]
pub(super) struct Scenario {
    /// Allies and enemies that an episode is drawn among.
    pub(super) teams: Vec<[Team; 2]>,
    /// Whether allies defend a base against several armies.
    pub(super) is_defence: bool,
    /// Steps of an episode at most.
    pub(super) limit: u32,
}

impl Scenario {
    /// What a name stands for, none where it stands for nothing that fits. The seed chooses who is added to enemies that are
    /// more.
    pub(super) fn named(name: &str, extra_seed: u64) -> Option<Self> {
        let (teams, has_more) = match name.rsplit_once('-') {
            Some((teams, "symmetric")) => (teams, Some(false)),
            Some((teams, "disadvantage")) => (teams, Some(true)),
            _ => (name, None),
        };
        // Published under this name are teams of three to eight.
        let teams = match teams.strip_prefix("6-8").filter(|_| has_more.is_some()) {
            Some(family) => tasks(&format!("3-8{family}")),
            None => tasks(teams).or_else(|| Some(vec![in_order(meeting(teams, &LETTERS)?)])),
        };
        let mut teams = teams?;
        if has_more == Some(true) {
            add_enemies(&mut teams, &mut generator(extra_seed));
        }
        let has_marines_alone = teams.iter().flatten().flatten().all(|kind| *kind == MARINE);
        let limit = if has_marines_alone { 100 } else { 150 };
        let scenario = Self { teams, is_defence: has_more.is_some(), limit };
        let [allies, enemies] = scenario.most();
        let fits = allies.min(enemies) > 0
            && allies + enemies <= CAPACITY
            && scenario.teams.iter().flatten().all(|team| team.iter().any(|kind| is_armed(*kind)));
        fits.then_some(scenario)
    }

    /// Units of the largest teams.
    pub(super) fn most(&self) -> [usize; 2] {
        [0, 1].map(|side| self.teams.iter().map(|teams| teams[side].len()).max().unwrap_or(0))
    }

    /// Whether some heal, so that allies are aimed at besides.
    pub(super) fn has_healers(&self) -> bool {
        self.teams.iter().any(|[allies, _]| allies.contains(&MEDIVAC))
    }

    /// Units of an army at most.
    fn army_size(&self) -> usize {
        self.most()[1].div_ceil(ARMIES).max(4)
    }

    /// What all rewards are divided by, so that an episode is worth about 20: of the first of the most varied, largest
    /// teams.
    pub(super) fn reward_scale(&self, book: &Book) -> f64 {
        let varied = |team: &Team| team.chunk_by(|one, next| one == next).count();
        let enemies = self.teams.iter().map(|[_, enemies]| enemies).rev();
        let reference = enemies.max_by_key(|team| (varied(team), team.len()));
        let body = |kind: &u8| {
            let UnitType { life, shield, .. } = book.types[usize::from(*kind)];
            f64::from(life + shield)
        };
        let all: f64 = reference.into_iter().flatten().map(body).sum();
        (all + DEATH * self.most()[1] as f64 + VICTORY) / 20.0
    }

    /// Draws teams and where they start.
    pub(super) fn draw(&self, (book, is_spread): (&Book, bool), random: &mut Random) -> Encounter {
        let [allies, enemies] = &self.teams[below(random, self.teams.len())];
        let mut encounter = Encounter::of(Battle::of(book, allies, enemies));
        let middle = [book.side / 2.0; 2];
        let angle = TAU * unit(random) as f32;
        let battle = &mut encounter.battle;
        if self.is_defence {
            place_team((battle, book), 0..allies.len(), middle, Some(random));
            encounter.armies = Armies::draw(enemies.len(), self.army_size(), random);
            place_armies((&mut encounter, book), (angle, is_spread), random);
        } else {
            let start = |way: f32| around(middle, angle, 7.0 * way);
            place_team((battle, book), 0..allies.len(), start(1.0), Some(random));
            let others = allies.len()..battle.count;
            place_team((battle, book), others, start(-1.0), Some(random));
        }
        encounter.begin(book, random);
        encounter
    }
}

fn around([x, y]: Point, angle: f32, distance: f32) -> Point {
    [x + distance * libm::cosf(angle), y + distance * libm::sinf(angle)]
}

/// Puts units beside a point, those of a type near each other; `offsets` moves each type's by up to one to each side.
fn place_team(
    (battle, book): (&mut Battle, &Book),
    units: core::ops::Range<usize>,
    point: Point,
    mut offsets: Option<&mut Random>,
) {
    let (mut centre, mut last) = (point, None);
    for number in units.clone() {
        let kind = battle.units[number].kind;
        if let Some(random) = offsets.as_mut().filter(|_| last.replace(kind) != Some(kind)) {
            centre = point.map(|part| part + 2.0 * unit(random) as f32 - 1.0);
        }
        place_beside((battle, book), number, (centre, units.start));
    }
}

/// Puts a unit on the first free turn of a spiral around a point; those from `first` on are in place.
fn place_beside(
    (battle, book): (&mut Battle, &Book),
    number: usize,
    (point, first): (Point, usize),
) {
    const GOLDEN_ANGLE: f32 = 2.399_96;
    let own = &book.types[battle.units[number].kind()];
    let largest = book.types.iter().map(|nature| nature.body).fold(0.0, f32::max);
    for turn in 0.. {
        let distance = 0.62 * (own.body + largest) * libm::sqrtf(turn as f32);
        let place = around(point, GOLDEN_ANGLE * turn as f32, distance);
        let is_free = battle.units[first..number].iter().all(|other| {
            let nature = &book.types[other.kind()];
            let way = [0, 1].map(|part| other.place[part] - place[part]);
            nature.layer != own.layer || length(way) >= own.body + nature.body
        });
        if is_free {
            battle.units[number].place = place.map(|part| part.clamp(0.0, book.side));
            return;
        }
    }
}

/// Puts every army on its own side of the base.
fn place_armies(
    (encounter, book): (&mut Encounter, &Book),
    (angle, is_spread): (f32, bool),
    random: &mut Random,
) {
    let Encounter { battle, armies, .. } = encounter;
    let mut first = battle.allies;
    // Types are mixed over armies; of each army they are in their order again.
    crate::random::shuffle(random, &mut battle.units[first..battle.count]);
    let count = armies.count;
    for (number, army) in armies.list[..count].iter_mut().enumerate() {
        let last = first + usize::from(army.size);
        battle.units[first..last].sort_by_key(|enemy| enemy.kind);
        let share = number as f32 / count as f32;
        let share = if is_spread { share * unit(random) as f32 } else { share };
        army.centre = around([book.side / 2.0; 2], angle + TAU * share, 14.0);
        place_team((battle, book), first..last, army.centre, None);
        battle.units[first..last].iter_mut().for_each(|enemy| enemy.army = number as u8);
        first = last;
    }
}

/// The teams of a family such as `3-8sz`, the same on both sides.
fn tasks(name: &str) -> Option<Vec<[Team; 2]>> {
    let (least, rest) = name.split_once('-')?;
    let letters = rest.find(|sign: char| !sign.is_ascii_digit())?;
    let (most, family) = rest.split_at(letters);
    let [least, most] = [least, most].map(|number| number.parse::<usize>().ok());
    let (least, most) = (least?, most?);
    let (kinds, helper): (&[u8], _) = match family {
        "sz" => (&[STALKER, ZEALOT], None),
        "csz" => (&[STALKER, ZEALOT], Some(COLOSSUS)),
        "MMM" => (&[MARINE, MARAUDER], Some(MEDIVAC)),
        "m" => (&[MARINE], None),
        _ => return None,
    };
    // Up to two helpers come on top.
    let helpers = if helper.is_some() { 2 } else { 0 };
    let sizes = least.max(1)..=most.min(CAPACITY).checked_sub(helpers)?;
    let mut teams = Vec::new();
    for size in sizes {
        let others = if kinds.len() > 1 { size } else { 0 };
        for (other, count) in (0..=others).flat_map(|other| (0..=helpers).map(move |c| (other, c)))
        {
            let mut team = vec![kinds[0]; size - other];
            team.resize(size, *kinds.last()?);
            team.resize(size + count, helper.unwrap_or(0));
            team.sort_unstable();
            teams.push([team.clone(), team]);
        }
    }
    (!teams.is_empty()).then_some(teams)
}

/// Gives enemies one unit more, of a type that the set has and that fights on its own.
fn add_enemies(teams: &mut [[Team; 2]], random: &mut Random) {
    let mut kinds: Vec<u8> = teams.iter().flatten().flatten().copied().collect();
    kinds.sort_unstable();
    kinds.dedup();
    kinds.retain(|kind| *kind != MEDIVAC && *kind != COLOSSUS);
    for [_, enemies] in teams {
        enemies.extend(kinds.get(below(random, kinds.len())));
        enemies.sort_unstable();
    }
}

/// What two teams are called, whatever order their units are in.
pub(super) fn name_of(teams: [Team; 2]) -> String {
    meeting_name(&in_order(teams), &LETTERS)
}

/// Units of both teams by their types, as scenarios have them.
pub(super) fn in_order(teams: [Team; 2]) -> [Team; 2] {
    teams.map(|mut team| {
        team.sort_unstable();
        team
    })
}
