//! Plays an episode and writes it down.

use sortie_envs::group_matching::{LEFT, Parameters, RIGHT, Ring, ring_of, sizes};
use sortie_envs::{EntitySet, Environment, Observation, Split, members};
use sortie_learn::play::Start;
use sortie_learn::{Act, Scene, Scenes};

use super::data::{AgentFacts, Captured, EpisodeResult, Event, EventKind, GroupFacts, State, Step};
use crate::failure::Failure;
use crate::views::lettered;
use crate::views::mind::Thought;
use crate::views::page::rounded;

/// Plays an episode of the environment and writes it down.
pub(super) fn capture(
    environment: &dyn Environment,
    start: Start,
    team: &mut dyn Act,
) -> Result<Captured, Failure> {
    let mut world = environment.open(1, Split::Test);
    let Start { world: mut random, team: own, .. } = start;
    let mut own = [own];
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
        states.push(shown(ring, &seen));
        if world.episode(0).done {
            break facts(ring);
        }
        let scene =
            Scene { instance: 0, state: &state, begins: steps.is_empty(), tasks_changed: false };
        let scenes = Scenes { environment: &*world, scenes: &[scene] };
        team.act(&scenes, &mut own, &mut actions)?;
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

/// Gives the states what was thought in them: agent by agent, state by state; none in the last.
pub(super) fn give_thoughts(states: &mut [State], thoughts: Vec<Thought>) {
    let mut thoughts = thoughts.into_iter();
    for state in states {
        let own: Vec<Thought> = thoughts.by_ref().take(state.places.len()).collect();
        state.thoughts = (!own.is_empty()).then_some(own);
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
    let groups = ring
        .groups()
        .enumerate()
        .map(|(group, set)| GroupFacts { name: lettered(group), members: members(set).collect() });
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
