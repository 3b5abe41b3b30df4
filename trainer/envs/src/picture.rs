//! What a state looks like, in plain shapes: terminals and pages draw every environment from its [`Picture`].

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Serialize;

use crate::observation::{Observation, members};
use crate::spec::Spec;

/// A state as it is drawn. Entities are counted as [`Environment::place`](crate::Environment::place) does: agents first,
/// things behind them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Where places are; none where nothing has a place.
    pub field: Option<Field>,
    /// Squares that are not free, the same ones in all states of an episode.
    pub cells: Vec<Cell>,
    /// All agents that exist, in their order.
    pub agents: Vec<Disc>,
    /// All else that has a name.
    pub things: Vec<Disc>,
    /// What belongs together.
    pub links: Vec<Link>,
}

/// The part of the plane that is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Field {
    /// The corner at the top, on the left.
    pub from: [f64; 2],
    /// The corner at the bottom, on the right.
    pub to: [f64; 2],
    /// The side of a cell; so far a key moves an agent.
    pub cell: f64,
    /// Whether places are whole columns and rows, which have their cell around them.
    pub is_grid: bool,
}

impl Field {
    /// Columns and rows of cells, from 0; the first row is at the top.
    pub fn grid(columns: usize, rows: usize) -> Self {
        let to = [columns, rows].map(|count| count as f64 - 0.5);
        Self { from: [-0.5; 2], to, cell: 1.0, is_grid: true }
    }

    /// A square around the origin, as far as `half` to each side; y grows upwards.
    pub fn plane(half: f64, cell: f64) -> Self {
        Self { from: [-half, half], to: [half, -half], cell, is_grid: false }
    }

    /// The same with the first row at the bottom.
    #[must_use]
    pub fn upwards(self) -> Self {
        let ([left, top], [right, bottom]) = (self.from, self.to);
        Self { from: [left, bottom], to: [right, top], ..self }
    }
}

/// A square of the ground.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Cell {
    /// Its middle.
    pub place: [f64; 2],
    /// What it is; nothing of free ones.
    pub kind: String,
    /// What is written on it: two characters at most.
    pub label: String,
    /// Whether nobody can be there.
    pub is_solid: bool,
    /// Those of the same number have the same colour.
    pub colour: Option<u8>,
}

/// How a disc is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outline {
    /// A circle.
    #[default]
    Circle,
    /// A square.
    Square,
    /// A square on its corner.
    Diamond,
    /// A triangle.
    Triangle,
    /// Two lines.
    Cross,
}

/// An agent or a thing.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Disc {
    /// What it is called: a letter, a number, or both.
    pub name: String,
    /// What is written on it, where that is not its name.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub label: String,
    /// What it is, such as a role.
    pub kind: &'static str,
    /// How it is drawn.
    pub outline: Outline,
    /// Those of the same number have the same colour.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colour: Option<u8>,
    /// Its middle; none of what is nowhere.
    pub place: Option<[f64; 2]>,
    /// How far it reaches; without one most of a cell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    /// How much there is of something.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub bars: Vec<Bar>,
    /// How it stands, in a few words: whenever they change, that is worth telling.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub status: String,
    /// What else is known of it.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub about: String,
    /// The subtask that it stands for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<usize>,
}

/// A share of a whole.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bar {
    /// Of what.
    pub name: &'static str,
    /// From 0 to 1.
    pub share: f64,
}

/// Two entities that belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Link {
    /// What they are.
    pub name: &'static str,
    /// One of them.
    pub from: usize,
    /// The other one.
    pub to: usize,
}

/// Features that are told of an entity of which nothing else is known.
const FEATURES: usize = 8;

impl Picture {
    /// That of an environment that gives none: entities that are nowhere, each with the first of its features that differ
    /// from zero.
    pub fn of_observation(spec: &Spec, seen: &Observation) -> Self {
        let slots = spec.shape.agents;
        let disc = |entity: usize| {
            let agent = (entity < slots).then_some(entity);
            let names = agent.map_or(&spec.features[..], |agent| spec.features_of(agent));
            let role = agent.map(|agent| spec.role_of(agent).map_or("agent", |role| role.name));
            let row = seen.rows.row(seen.row_of(entity)).take(FEATURES);
            let told = row
                .filter_map(|(column, value)| Some(format!("{} {value:.2}", names.get(column)?)));
            Disc {
                name: agent.unwrap_or(entity - seen.agents().min(entity)).to_string(),
                kind: role.unwrap_or("thing"),
                about: told.collect::<Vec<_>>().join(", "),
                task: (agent.is_none() && seen.entity_task[entity] != 0)
                    .then(|| seen.task_of(entity).into()),
                ..Disc::default()
            }
        };
        let agents = (0..seen.agents()).map(disc).collect();
        Self { agents, things: members(seen.things()).map(disc).collect(), ..Self::default() }
    }

    /// Agents and things by their numbers.
    pub fn entity(&self, entity: usize) -> Option<&Disc> {
        self.agents.iter().chain(&self.things).nth(entity)
    }
}

/// `A` for the first of some things, `A2` for the one after `Z`.
pub fn lettered(number: usize) -> String {
    let letter = char::from(b'A' + (number % 26) as u8);
    match number / 26 {
        0 => letter.to_string(),
        round => format!("{letter}{}", round + 1),
    }
}

#[cfg(test)]
mod tests {
    use alloc::collections::BTreeMap;

    use super::*;
    use crate::random::generator;
    use crate::{EntitySet, Split, open};

    #[test]
    fn without_a_picture_entities_are_shown_by_what_is_observed_of_them() {
        // Sets of up to five agents have room for some that do not exist.
        let city = open("save-the-city", Split::Train, 1, &BTreeMap::new());
        let (mut city, mut random) = (city.expect("it opens"), generator(1));
        let (mut state, mut seen) = (Vec::new(), Observation::default());
        for _ in 0..10 {
            city.reset(0, &mut random);
            state.clear();
            city.save(0, &mut state);
            city.observe(&state, 0, EntitySet::MAX, &mut seen);
            let shown = Picture::of_observation(city.spec(), &seen);
            let own = city.picture(&state);
            assert_eq!(
                (shown.agents.len(), shown.things.len()),
                (own.agents.len(), own.things.len())
            );
            let tasks: Vec<_> = own.things.iter().map(|thing| thing.task).collect();
            assert_eq!(shown.things.iter().map(|thing| thing.task).collect::<Vec<_>>(), tasks);
            let health = format!("health {:.2}", own.things[0].bars[0].share);
            assert!(shown.things[0].about.contains(&health), "{}", shown.things[0].about);
            assert!(
                shown.field.is_none() && shown.agents.iter().all(|agent| agent.place.is_none())
            );
            let last = shown.entity(shown.agents.len()).expect("the first thing");
            assert_eq!(last, &shown.things[0]);
        }
    }

    #[test]
    fn letters_go_on_behind_the_last() {
        assert_eq!([0, 25, 26, 53].map(lettered), ["A", "Z", "A2", "B3"]);
    }
}
