//! Plays an episode and writes it down.

use sortie_envs::particle::{Disc, Picture, Point, picture_of};
use sortie_envs::{Environment, Spec};
use sortie_learn::{Act, Thought};

use super::data::{AgentFacts, Captured, State, Step};
use super::events::{Seen, events};
use crate::failure::Failure;
use crate::views::mind;
use crate::views::page::rounded;
use crate::views::particle::{kind_name, lettered, role_of};
use crate::views::witness::{Taken, Witnessed, witness};

/// Half of the side that is drawn at least, and at most: who goes farther is drawn at the edge.
const HALF: [f64; 2] = [1.1, 2.0];

/// Plays an episode of the environment and writes it down; with what the team thinks, if it tells.
pub(super) fn capture(
    environment: &dyn Environment,
    episode: (u64, usize),
    team: &mut dyn Act,
) -> Result<Captured, Failure> {
    let Witnessed { pictures, steps, thoughts, .. } =
        witness(environment, episode, team, picture_of)?;
    let rewards = steps.iter().map(|step| step.rewards.clone());
    let rewards = std::iter::once(Vec::new()).chain(rewards);
    let seen = pictures.into_iter().zip(rewards);
    let seen: Vec<Seen> = seen.map(|(picture, rewards)| Seen { picture, rewards }).collect();
    let steps = steps.into_iter().map(|Taken { actions, reward, rewards }| Step {
        actions,
        reward: rounded(reward),
        rewards: rewards.into_iter().map(rounded).collect(),
    });
    let mut captured = captured(environment.spec(), &seen, steps.collect());
    give_thoughts(&mut captured, thoughts.into_iter().map(told).collect());
    Ok(captured)
}

/// Gives the states what was thought in them: agent by agent, state by state; none in the last.
pub(super) fn give_thoughts(captured: &mut Captured, thoughts: Vec<mind::Thought>) {
    let of_states = thoughts.chunks(captured.agents.len());
    for (state, own) in captured.states.iter_mut().zip(of_states) {
        state.thoughts = Some(own.to_vec());
    }
}

fn told(thought: Thought) -> mind::Thought {
    let numbers = |numbers: Vec<f32>| numbers.into_iter().map(rounded).collect();
    let attention = thought.attention.into_iter();
    let attention =
        attention.map(|(entity, weights)| mind::Attention { entity, weights: numbers(weights) });
    mind::Thought { utilities: numbers(thought.scores), attention: attention.collect() }
}

fn captured(spec: &Spec, seen: &[Seen], steps: Vec<Step>) -> Captured {
    let agents = 0..spec.shape.agents;
    let roles: Vec<&str> = agents.clone().map(|agent| role_of(spec, agent)).collect();
    let first = seen.first().map(|seen| &seen.picture);
    let fact = |agent: usize| {
        let drawn = first.and_then(|picture| picture.agents.get(agent)).copied();
        let drawn = drawn.unwrap_or_default();
        AgentFacts {
            name: agent.to_string(),
            role: role_of(spec, agent),
            actions: spec.actions_of(agent).to_vec(),
            radius: drawn.disc.map(|disc| disc.radius),
            takes: drawn.takes,
            partner: drawn.partner,
            goal: drawn.goal,
        }
    };
    let agents: Vec<AgentFacts> = agents.map(fact).collect();
    let things = first.map_or(&[][..], |picture| &picture.things).iter().enumerate();
    let things = things.map(|(number, thing)| thing.kind.is_none().then(|| lettered(number)));
    let takers = agents.iter().filter_map(|agent| agent.takes);
    Captured {
        team: team(spec),
        things: things.collect(),
        half: half(seen),
        kinds: takers.map(kind_name).collect(),
        states: seen.iter().map(|seen| shown(&seen.picture)).collect(),
        steps,
        events: events(seen, &roles),
        result: "over",
        agents,
    }
}

/// "6 collectors, 2 banks".
fn team(spec: &Spec) -> String {
    let named = |count: usize, role| format!("{count} {role}{}", if count == 1 { "" } else { "s" });
    match &spec.roles[..] {
        [] => named(spec.shape.agents, "agent"),
        roles => {
            let roles = roles.iter().map(|role| named(role.agents.len(), role.name));
            roles.collect::<Vec<_>>().join(", ")
        }
    }
}

/// Half of the side in which all agents are at all times, as far as that is drawn.
fn half(seen: &[Seen]) -> f64 {
    let discs = seen.iter().flat_map(|seen| &seen.picture.agents).filter_map(|agent| agent.disc);
    let far = discs.map(|Disc { place: [x, y], radius }| x.abs().max(y.abs()) + radius);
    rounded(far.fold(0.0, f64::max).clamp(HALF[0], HALF[1]))
}

fn shown(picture: &Picture) -> State {
    let place = |disc: Option<Disc>| disc.map(|disc| disc.place.map(rounded));
    let places = |discs: &mut dyn Iterator<Item = Option<Disc>>| -> Vec<Option<Point>> {
        discs.map(place).collect()
    };
    let Picture { agents, things } = picture;
    State {
        places: places(&mut agents.iter().map(|agent| agent.disc)),
        holds: agents.iter().map(|agent| agent.holds).collect(),
        says: agents.iter().map(|agent| agent.says).collect(),
        things: places(&mut things.iter().map(|thing| thing.disc)),
        kinds: things.iter().map(|thing| thing.kind).collect(),
        thoughts: None,
    }
}
