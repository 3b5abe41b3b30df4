//! What is worth jumping to in an episode.

use sortie_envs::particle::{Disc, Picture};

use super::data::{Event, EventKind};
use crate::views::particle::{kind_name, lettered};

/// Agents of these roles lose by touching each other.
const BUMPING: [&str; 2] = ["collector", "agent"];

/// One state as it was seen, and what each agent had earned by the step before it.
#[derive(Debug)]
pub(super) struct Seen {
    pub(super) picture: Picture,
    pub(super) rewards: Vec<f64>,
}

/// The events of an episode, in order.
pub(super) fn events(seen: &[Seen], roles: &[&str]) -> Vec<Event> {
    let mut events = Vec::new();
    for (at, pair) in seen.windows(2).enumerate() {
        let [before, after] = pair else { continue };
        let mut add = |kind, of, text| events.push(Event { at: at + 1, kind, of, text });
        for agent in 0..roles.len() {
            let (was, is) = (before.picture.agents[agent], after.picture.agents[agent]);
            match (was.holds, is.holds) {
                (None, Some(kind)) => {
                    add(EventKind::Taken, agent, format!("{agent} takes {}", kind_name(kind)));
                }
                (Some(kind), None) => {
                    let text = format!("{agent} brings {} to its bank", kind_name(kind));
                    add(EventKind::Delivered, agent, text);
                }
                _ => {}
            }
            // Near its goal a rover earns, elsewhere it loses.
            let near = |seen: &Seen| seen.rewards.get(agent).is_some_and(|reward| *reward > 0.0);
            if let (Some(goal), Some(_)) = (is.goal, is.disc)
                && near(after)
                && !near(before)
            {
                add(EventKind::Near, agent, format!("{agent} is near {}", lettered(goal)));
            }
            for other in 0..agent {
                let touch =
                    |seen: &Seen| touch([other, agent].map(|one| &seen.picture.agents[one].disc));
                let bump = [other, agent].iter().all(|one| BUMPING.contains(&roles[*one]));
                if bump && touch(after) && !touch(before) {
                    add(EventKind::Touch, agent, format!("{other} and {agent} touch"));
                }
            }
        }
    }
    events
}

fn touch(discs: [&Option<Disc>; 2]) -> bool {
    let [Some(one), Some(other)] = discs else { return false };
    let [x, y] = [0, 1].map(|axis| one.place[axis] - other.place[axis]);
    x.hypot(y) < one.radius + other.radius
}
