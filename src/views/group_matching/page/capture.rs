//! Plays an episode and writes it down.

use sortie_envs::group_matching::{LEFT, Parameters, RIGHT, Ring, ring_of, sizes};
use sortie_envs::{EntitySet, Environment, Observation, Random, members};

use super::data::{AgentFacts, Captured, EpisodeResult, Event, EventKind, GroupFacts, State, Step};
use crate::failure::{Exit, Failure};
use crate::views::acting::Actors;
use crate::views::group_matching::group_name;
use crate::views::mind::Thought;
use crate::views::page::rounded;

/// Who acts.
pub(super) enum Team<'a> {
    /// The environment's script, which may draw.
    Script(Random),
    /// A mind for each agent.
    Actors(Actors<'a>),
}

/// Plays the world's next episode and writes it down.
pub(super) fn capture(
    mut world: Box<dyn Environment>,
    mut random: Random,
    team: &mut Team<'_>,
) -> Result<Captured, Failure> {
    world.reset(0, &mut random);
    let spec = world.spec().clone();
    let (sizes, shape) = (sizes(&spec), spec.shape);
    let (mut state, mut seen) = (Vec::new(), Observation::default());
    let (mut states, mut steps) = (Vec::new(), Vec::new());
    let mut actions = vec![0; shape.agents];
    let (agents, groups) = loop {
        state.clear();
        world.save(0, &mut state);
        world.observe(&state, 0, EntitySet::MAX, &mut seen);
        let ring = ring_of(&sizes, &state).map_err(Failure::bug)?;
        let mut shown = shown(ring, &seen);
        if world.episode(0).done {
            states.push(shown);
            break facts(ring);
        }
        shown.thoughts = act(team, &*world, &state, &seen, &mut actions)?;
        states.push(shown);
        let before = ring.cells.to_vec();
        let step = world.step(0, &actions, &mut random).map_err(Failure::bug)?;
        let mut after = Vec::new();
        world.save(0, &mut after);
        let ring = ring_of(&sizes, &after).map_err(Failure::bug)?;
        steps.push(Step {
            actions: actions.clone(),
            reward: rounded(step.reward),
            slipped: slipped(&sizes, &before, &actions, ring.cells),
        });
    };
    let events = events(&states, &steps, &agents, &groups);
    let solved = world.episode(0).solved;
    let result = if solved { EpisodeResult::Solved } else { EpisodeResult::TimedOut };
    let (cells, actions) = (sizes.cells, spec.actions);
    Ok(Captured { cells, actions, agents, groups, states, steps, events, result })
}

/// Writes the team's actions; tells its thoughts where it has any.
fn act(
    team: &mut Team<'_>,
    world: &dyn Environment,
    state: &[u8],
    seen: &Observation,
    actions: &mut [u16],
) -> Result<Option<Vec<Thought>>, Failure> {
    match team {
        Team::Script(random) => {
            let nobody = vec![u8::MAX; actions.len()];
            if world.scripted(state, &nobody, random, actions) {
                return Ok(None);
            }
            let message = format!("`{}` has no scripted team", world.spec().name);
            Err(Failure::new(Exit::Usage, message))
        }
        Team::Actors(actors) => actors.act(seen, &world.spec().shape, actions).map(Some),
    }
}

fn shown(ring: Ring<'_>, seen: &Observation) -> State {
    let sees = seen.observable.iter().map(|set| members(set & seen.present).collect());
    let first = |agent: usize| ring.groups().position(|set| set >> agent & 1 == 1).unwrap_or(0);
    State {
        places: ring.cells.to_vec(),
        sees: sees.collect(),
        allocation: (0..ring.cells.len()).map(first).collect(),
        gathered: ring.groups().map(|set| ring.is_matched(set)).collect(),
        thoughts: None,
    }
}

fn facts(ring: Ring<'_>) -> (Vec<AgentFacts>, Vec<GroupFacts>) {
    let groups = ring.groups().enumerate().map(|(group, set)| GroupFacts {
        name: group_name(group),
        members: members(set).collect(),
    });
    let groups: Vec<GroupFacts> = groups.collect();
    let agent = |agent: usize| {
        let own = groups.iter().enumerate().filter(|(_, facts)| facts.members.contains(&agent));
        let own: Vec<usize> = own.map(|(group, _)| group).collect();
        let first = own.first().map_or("-", |group| &groups[*group].name);
        AgentFacts { name: format!("{first}{agent}"), groups: own }
    };
    ((0..ring.cells.len()).map(agent).collect(), groups)
}

/// Agents that are not where their action leads.
fn slipped(sizes: &Parameters, before: &[u8], actions: &[u16], after: &[u8]) -> Vec<usize> {
    let meant = |cell: u8, action: u16| {
        let by = match action {
            LEFT => sizes.cells - 1,
            RIGHT => 1,
            _ => 0,
        };
        (usize::from(cell) + by) % sizes.cells
    };
    let agents = before.iter().zip(actions).zip(after).enumerate();
    let slipped =
        agents.filter(|(_, ((from, action), to))| meant(**from, **action) != usize::from(**to));
    slipped.map(|(agent, _)| agent).collect()
}

/// What is worth jumping to, in order.
fn events(
    states: &[State],
    steps: &[Step],
    agents: &[AgentFacts],
    groups: &[GroupFacts],
) -> Vec<Event> {
    let mut events = Vec::new();
    for (at, state) in states.iter().enumerate() {
        let before = at.checked_sub(1);
        for agent in before.map(|before| &steps[before].slipped).into_iter().flatten() {
            let text = format!("{} slips", agents[*agent].name);
            events.push(Event { at, kind: EventKind::Slipped, of: *agent, text });
        }
        for (group, facts) in groups.iter().enumerate().filter(|(_, facts)| facts.members.len() > 1)
        {
            let was = before.is_some_and(|before| states[before].gathered[group]);
            let (kind, what) = match (was, state.gathered[group]) {
                (false, true) if at == 0 => (EventKind::Gathered, "is together from the start"),
                (false, true) => (EventKind::Gathered, "gathers"),
                (true, false) => (EventKind::Parted, "parts"),
                _ => continue,
            };
            let text = format!("group {} {what}", facts.name);
            events.push(Event { at, kind, of: group, text });
        }
    }
    events
}
