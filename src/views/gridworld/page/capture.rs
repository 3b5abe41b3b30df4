//! Plays an episode and writes it down.

use sortie_envs::gridworld::{Picture, SIDE, picture_of};
use sortie_envs::{Environment, members};
use sortie_learn::Act;

use super::data::{AgentFacts, Captured, Event, EventKind, Head, State, Step, Thought};
use crate::failure::Failure;
use crate::views::gridworld::lettered;
use crate::views::mind;
use crate::views::page::rounded;
use crate::views::witness::{Taken, Witnessed, witness};

/// Plays an episode of the environment and writes it down; with what the team thinks, if it tells.
pub(super) fn capture(
    environment: &dyn Environment,
    episode: (u64, usize),
    team: &mut dyn Act,
) -> Result<Captured, Failure> {
    let Witnessed { pictures, steps, thoughts, solved } =
        witness(environment, episode, team, picture_of)?;
    let spec = environment.spec();
    let fact = |agent: usize| AgentFacts { name: agent.to_string(), actions: spec.actions.clone() };
    let step = |Taken { actions, reward, .. }| Step { actions, reward: rounded(reward) };
    let mut captured = Captured {
        team: format!("{} agents", spec.shape.agents),
        agents: (0..spec.shape.agents).map(fact).collect(),
        map: spec.map.clone(),
        visits: team.visits(),
        events: events(&pictures),
        states: pictures.into_iter().map(shown).collect(),
        steps: steps.into_iter().map(step).collect(),
        result: if solved { "solved" } else { "timed-out" },
    };
    give_thoughts(&mut captured, thoughts.into_iter().map(told).collect());
    Ok(captured)
}

/// Gives the states what agents of a bundle thought in them, which have no heads.
pub(super) fn give_utilities(captured: &mut Captured, thoughts: Vec<mind::Thought>) {
    let told = |mind::Thought { utilities, .. }| Thought { utilities, heads: Vec::new() };
    give_thoughts(captured, thoughts.into_iter().map(told).collect());
}

/// Gives the states what was thought in them: agent by agent, state by state; none in the last.
fn give_thoughts(captured: &mut Captured, thoughts: Vec<Thought>) {
    let of_states = thoughts.chunks(captured.agents.len());
    for (state, own) in captured.states.iter_mut().zip(of_states) {
        state.thoughts = Some(own.to_vec());
    }
}

fn told(thought: sortie_learn::Thought) -> Thought {
    let head = |sortie_learn::Head { name, pays, likes, acts }| Head {
        name,
        pays: rounded(pays),
        likes,
        acts,
    };
    Thought {
        utilities: thought.scores.into_iter().map(rounded).collect(),
        heads: thought.heads.into_iter().map(head).collect(),
    }
}

fn shown(picture: Picture) -> State {
    let Picture { cells, found, tiers, pits } = picture;
    let open = pits.iter().enumerate().filter(|(_, pit)| pit.is_open).map(|(pit, _)| pit);
    State {
        open: open.collect(),
        pits: pits.iter().map(|pit| rounded(pit.probability)).collect(),
        cells,
        found,
        tiers,
        thoughts: None,
    }
}

/// What is worth jumping to, in order.
fn events(pictures: &[Picture]) -> Vec<Event> {
    let mut events = Vec::new();
    for (at, pair) in pictures.windows(2).enumerate() {
        let [before, after] = pair else { continue };
        let mut add = |kind, of, text| events.push(Event { at: at + 1, kind, of, text });
        for agent in 0..after.cells.len() {
            for treasure in members((after.found[agent] & !before.found[agent]).into()) {
                let text = format!("{agent} finds {}", lettered(treasure));
                add(EventKind::Found, Some(agent), text);
            }
            // Whoever walks comes one cell far.
            if distance(before.cells[agent], after.cells[agent]) > 1 {
                add(EventKind::Fall, Some(agent), format!("{agent} falls into a pit"));
            }
        }
        if after.tiers > before.tiers {
            add(EventKind::Tier, None, format!("tier {} is finished", after.tiers));
        }
    }
    events
}

/// Steps from one cell to another, if nothing were in the way.
fn distance(one: u16, other: u16) -> usize {
    let place = |cell: u16| [usize::from(cell) / SIDE, usize::from(cell) % SIDE];
    let [one, other] = [place(one), place(other)];
    one[0].abs_diff(other[0]) + one[1].abs_diff(other[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_falls_and_tiers_are_events() {
        let picture = |cells: [u16; 2], found: [u8; 2], tiers| Picture {
            cells: cells.to_vec(),
            found: found.to_vec(),
            tiers,
            pits: Vec::new(),
        };
        let events = events(&[
            picture([21, 45], [0, 0], 0),
            picture([22, 45], [0, 0b100], 0),
            picture([42, 100], [1, 0b100], 1),
        ]);
        let told: Vec<(usize, &str)> =
            events.iter().map(|event| (event.at, &*event.text)).collect();
        let wanted = [
            (1, "1 finds C"),
            (2, "0 finds A"),
            (2, "1 falls into a pit"),
            (2, "tier 1 is finished"),
        ];
        assert_eq!(told, wanted);
    }
}
