//! What pages show of any environment, as their script reads it: its pictures and what its [`Spec`] says, of an episode that
//! was played before and of one that is played as it is looked at.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Serialize;
use sortie_envs::picture::{Cell, Disc, Field, Link};
use sortie_envs::{
    EntitySet, Environment, Episode, Metric, Observation, Spec, UNASSIGNED, deployed_tasks,
};

use crate::team_values::{TeamValues, candidates};
use crate::thoughts::{Thought, rounded};

/// An instance of an environment.
#[derive(Clone, Copy)]
pub struct Glance<'a> {
    /// All instances.
    pub worlds: &'a dyn Environment,
    /// The one that is looked at.
    pub instance: usize,
}

/// What does not change while an episode is played.
#[derive(Clone, Debug, Serialize)]
pub struct Facts {
    /// How many agents there are of each kind.
    pub team: String,
    /// Where places are.
    pub field: Option<Field>,
    /// The agents.
    pub agents: Vec<AgentFacts>,
    /// Names of what can be reached on the way to the task.
    pub milestones: Vec<String>,
    /// Names of what is counted.
    pub metrics: Vec<String>,
    /// What can be done to things, in words; nothing where nothing can.
    pub disturbance: &'static str,
    /// Steps after which an episode times out.
    pub limit: u32,
}

/// What does not change about an agent.
#[derive(Clone, Debug, Serialize)]
pub struct AgentFacts {
    /// What it is called.
    pub name: String,
    /// What it is.
    pub kind: &'static str,
    /// What it can do.
    pub actions: Vec<String>,
}

/// One state, and what the team thinks in it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct State {
    /// All agents that exist.
    pub agents: Vec<Disc>,
    /// All else.
    pub things: Vec<Disc>,
    /// What belongs together.
    pub links: Vec<Link>,
    /// The squares that differ from those of the state before, by their numbers: all of them in the first one.
    pub cells: Vec<(usize, Cell)>,
    /// What the episode has come to, as the facts name it.
    pub metrics: Vec<Option<f64>>,
    /// What each agent cannot do.
    pub unavailable: Vec<Vec<usize>>,
    /// The milestones that can be reached next, as bits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub affordances: Option<u32>,
    /// Each agent's subtask; empty where nobody is assigned.
    pub allocation: Vec<Option<u8>>,
    /// Whether the allocator decided in this state.
    pub decided: bool,
    /// What each agent thinks, where anything is known of it; none of agents that do not decide.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thoughts: Option<Vec<Option<Thought>>>,
    /// What teams are worth, one entry for each subtask, none for closed ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub values: Option<Vec<Option<TeamValues>>>,
}

/// What happened between two states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Of the agents.
    pub actions: Vec<u16>,
    /// The team's reward.
    pub reward: f64,
    /// Of the agents, where they earn rewards of their own.
    pub agent_rewards: Vec<f64>,
    /// Of the subtasks, where they do.
    pub task_rewards: Vec<f64>,
    /// The milestone that was reached.
    pub milestone: Option<usize>,
}

/// Something worth jumping to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Event {
    /// The state in which it shows.
    pub at: usize,
    /// The agent or thing, agents first.
    pub of: Option<usize>,
    /// What is told of it.
    pub text: String,
}

/// A state as it is shown, and the step that led to it.
#[derive(Clone, Debug)]
pub struct Shown {
    /// None where the episode begins.
    pub step: Option<Step>,
    /// The state.
    pub state: State,
    /// All squares.
    cells: Vec<Cell>,
    /// The subtasks that are not finished, as bits.
    pub open_tasks: u32,
}

impl Facts {
    /// At the first state of an episode.
    pub fn at(first: Glance<'_>) -> Self {
        let spec = first.worlds.spec();
        let picture = first.worlds.picture(&saved(first));
        let agent = |(number, disc): (usize, &Disc)| AgentFacts {
            name: disc.name.clone(),
            kind: disc.kind,
            actions: spec.actions_of(number).iter().map(|name| spaced(name)).collect(),
        };
        let metrics = spec.metrics.iter().filter(|metric| is_counted(spec, metric));
        Self {
            team: team(&picture.agents),
            field: picture.field,
            agents: picture.agents.iter().enumerate().map(agent).collect(),
            milestones: spec.milestones.iter().map(|name| spaced(name)).collect(),
            metrics: metrics.map(|metric| metric.name.to_string()).collect(),
            disturbance: spec.disturbance,
            limit: spec.episode_limit,
        }
    }
}

/// "2 firefighters, 1 builder".
fn team(agents: &[Disc]) -> String {
    let mut kinds: Vec<(&str, usize)> = Vec::new();
    for agent in agents {
        match kinds.iter_mut().find(|(kind, _)| *kind == agent.kind) {
            Some((_, count)) => *count += 1,
            None => kinds.push((agent.kind, 1)),
        }
    }
    let told = kinds.into_iter().map(|(kind, count)| match count {
        1 => format!("1 {kind}"),
        count => format!("{count} {kind}s"),
    });
    told.collect::<Vec<_>>().join(", ")
}

/// Names in words.
fn spaced(name: &str) -> String {
    name.replace('_', " ")
}

fn saved(seen: Glance<'_>) -> Vec<u8> {
    let mut state = Vec::new();
    seen.worlds.save(seen.instance, &mut state);
    state
}

impl Shown {
    /// The state that there is now.
    pub fn at(seen: Glance<'_>) -> Self {
        let (worlds, state) = (seen.worlds, saved(seen));
        let (picture, mut observed) = (worlds.picture(&state), Observation::default());
        worlds.observe(&state, 0, EntitySet::MAX, &mut observed);
        let unavailable = observed.available.iter().zip(0..picture.agents.len());
        let unavailable = unavailable.map(|(available, agent)| {
            let actions = 0..worlds.spec().actions_of(agent).len();
            actions.filter(|action| available >> action & 1 == 0).collect()
        });
        let state = State {
            cells: picture.cells.iter().cloned().enumerate().collect(),
            unavailable: unavailable.collect(),
            metrics: metrics(worlds.spec(), &worlds.episode(seen.instance)),
            affordances: worlds.affordances(&state),
            agents: picture.agents.into_iter().map(readable).collect(),
            things: picture.things.into_iter().map(readable).collect(),
            links: picture.links,
            ..State::default()
        };
        Self {
            step: None,
            state,
            cells: picture.cells,
            open_tasks: deployed_tasks(observed.open_tasks),
        }
    }

    /// The same behind another state: of squares those that differ from there.
    #[must_use]
    pub fn behind(mut self, before: Option<&Self>, step: Option<Step>) -> Self {
        let known = before.map(|before| &before.cells[..]).unwrap_or_default();
        self.state.cells.retain(|(number, cell)| known.get(*number) != Some(cell));
        Self { step, ..self }
    }

    /// Notes who is assigned where: `[A]` subtasks, of which there are none where nobody is assigned.
    pub fn assign(&mut self, allocation: &[u8], decided: bool) {
        let own = allocation.iter().take(self.state.agents.len());
        self.state.allocation = own.map(|task| (*task != UNASSIGNED).then_some(*task)).collect();
        self.state.decided = decided;
    }

    /// The agents that are assigned to a subtask, as bits.
    fn team(&self, task: usize) -> u64 {
        let own = self.state.allocation.iter().enumerate();
        let here = own.filter(|(_, own)| own.is_some_and(|own| usize::from(own) == task));
        here.fold(0, |team, (agent, _)| team | 1 << agent)
    }

    /// What is known of the teams at each subtask, and of others without `absent` agents that might be there; none of closed
    /// ones. `ask` values teams, bit a of which stands for agent a, at a subtask.
    ///
    /// # Errors
    /// As `ask`.
    pub fn team_values<E>(
        &self,
        team_max: usize,
        absent: u64,
        mut ask: impl FnMut(usize, &[u64]) -> Result<Vec<f32>, E>,
    ) -> Result<Vec<Option<TeamValues>>, E> {
        let tasks = self.state.things.iter().filter_map(|thing| thing.task).max();
        let at = |task: usize| {
            if self.open_tasks >> task & 1 == 0 {
                return Ok(None);
            }
            let chosen = self.team(task);
            let mut teams = candidates(self.state.agents.len(), team_max, chosen);
            teams.retain(|team| team & absent == 0);
            let values = ask(task, &teams)?;
            Ok((!values.is_empty()).then(|| TeamValues::of(&teams, &values, chosen)))
        };
        (0..tasks.map_or(0, |last| last + 1)).map(at).collect()
    }

    /// What is worth jumping to: whose status is another one than before, what was reached, and who is assigned elsewhere.
    pub fn events(&self, facts: &Facts, at: usize, before: Option<&Self>) -> Vec<Event> {
        let Some(before) = before else { return Vec::new() };
        let mut events = Vec::new();
        let mut add = |of, text| events.push(Event { at, of, text });
        let reached = self.step.as_ref().and_then(|step| step.milestone);
        if let Some(name) = reached.and_then(|milestone| facts.milestones.get(milestone)) {
            add(None, name.clone());
        }
        for (entity, (was, is)) in before.state.discs().zip(self.state.discs()).enumerate() {
            if was.status != is.status && !is.status.is_empty() {
                add(Some(entity), format!("{} {}: {}", is.kind, is.name, is.status));
            }
        }
        let moved: Vec<String> = self.moved(&before.state).collect();
        if !moved.is_empty() {
            add(None, format!("reallocated: {}", moved.join(", ")));
        }
        events
    }

    /// The agents that are assigned to another subtask than before, as text. In final states nobody is assigned.
    fn moved<'a>(&'a self, before: &'a State) -> impl Iterator<Item = String> + 'a {
        let State { agents, things, allocation, .. } = &self.state;
        let pairs = before.allocation.iter().zip(allocation).zip(agents);
        pairs.filter(|((from, to), _)| from != to).filter_map(|((_, to), agent)| {
            let task = usize::from((*to)?);
            let thing = things.iter().find(|thing| thing.task == Some(task));
            let name = thing.map_or_else(|| task.to_string(), |thing| thing.name.clone());
            Some(format!("{} to {name}", agent.name))
        })
    }
}

impl State {
    fn discs(&self) -> impl Iterator<Item = &Disc> {
        self.agents.iter().chain(&self.things)
    }
}

/// With as many decimals as are read.
fn readable(mut disc: Disc) -> Disc {
    disc.place = disc.place.map(|place| place.map(rounded));
    disc.bars.iter_mut().for_each(|bar| bar.share = rounded(bar.share));
    disc
}

/// Whether a metric is shown: those that evaluations tell of, but not each milestone by itself.
fn is_counted(spec: &Spec, metric: &Metric) -> bool {
    metric.is_reported && !spec.milestones.iter().any(|name| *name == metric.name)
}

fn metrics(spec: &Spec, episode: &Episode) -> Vec<Option<f64>> {
    let values = spec.metrics.iter().zip(&episode.metrics);
    let told = values.filter(|(metric, _)| is_counted(spec, metric));
    told.map(|(_, value)| value.map(rounded)).collect()
}

impl Step {
    /// What the last step came to for these actions.
    pub fn at(seen: Glance<'_>, actions: &[u16], reward: f64) -> Self {
        let Glance { worlds, instance } = seen;
        let mut observed = Observation::default();
        worlds.observe(&saved(seen), 0, 0, &mut observed);
        let rounded_all = |rewards: &[f64]| rewards.iter().copied().map(rounded).collect();
        Self {
            actions: actions[..observed.agents()].to_vec(),
            reward: rounded(reward),
            agent_rewards: rounded_all(worlds.agent_rewards(instance)),
            task_rewards: rounded_all(worlds.task_rewards(instance)),
            milestone: worlds.milestone(instance),
        }
    }
}

/// How an episode has ended, by the name of a style.
pub fn result(spec: &Spec, episode: &Episode) -> &'static str {
    match (episode.solved, episode.timed_out) {
        _ if !spec.has_success => "over",
        (true, _) => "solved",
        (false, true) => "timed-out",
        (false, false) => "lost",
    }
}

#[cfg(test)]
mod tests {
    use alloc::borrow::ToOwned;
    use alloc::collections::BTreeMap;
    use alloc::vec;

    use sortie_envs::random::generator;
    use sortie_envs::{Split, open};

    use super::*;

    fn facts(milestones: &[&str]) -> Facts {
        let milestones = milestones.iter().map(|name| (*name).to_owned()).collect();
        let world = open("save-the-city", Split::Test, 1, &BTreeMap::new()).expect("it opens");
        Facts { milestones, ..Facts::at(Glance { worlds: &*world, instance: 0 }) }
    }

    /// One agent, at one of two buildings of which the first stands so.
    fn shown(status: &str, task: Option<u8>, step: Option<Step>) -> Shown {
        let disc =
            |name: &str, kind, task| Disc { name: name.into(), kind, task, ..Disc::default() };
        let first = Disc { status: status.into(), ..disc("a", "building", Some(0)) };
        let state = State {
            agents: vec![disc("B0", "builder", None)],
            things: vec![first, disc("b", "building", Some(1))],
            allocation: vec![task],
            ..State::default()
        };
        Shown { step, state, cells: Vec::new(), open_tasks: 0b11 }
    }

    #[test]
    fn what_changes_is_worth_jumping_to() {
        let reward = Step {
            actions: vec![0],
            reward: 0.0,
            agent_rewards: Vec::new(),
            task_rewards: Vec::new(),
            milestone: Some(1),
        };
        let states = [
            shown("burning", Some(0), None),
            shown("burning", Some(1), None),
            shown("open", Some(1), Some(reward)),
            shown("", None, None),
        ];
        let facts = facts(&["log", "wood"]);
        let told = |at: usize| {
            let before = at.checked_sub(1).map(|before| &states[before]);
            let events = states[at].events(&facts, at, before).into_iter();
            events.map(|event| (event.of, event.text)).collect::<Vec<_>>()
        };
        assert_eq!(told(0), []);
        assert_eq!(told(1), [(None, "reallocated: B0 to b".to_owned())]);
        let reached = (None, "wood".to_owned());
        assert_eq!(told(2), [reached, (Some(1), "building a: open".to_owned())]);
        assert_eq!(told(3), [], "in final states nobody is assigned");
    }

    #[test]
    fn states_tell_of_squares_that_have_changed() {
        let world = open("gridworld/flip-2", Split::Test, 1, &BTreeMap::new());
        let mut world = world.expect("it opens");
        let mut random = generator(1);
        world.reset(0, &mut random);
        let first = Shown::at(Glance { worlds: &*world, instance: 0 }).behind(None, None);
        assert_eq!(first.state.cells.len(), first.cells.len());
        let mut before = first;
        for _ in 0..40 {
            world.step(0, &[3, 0], &mut random).expect("a step");
            let now = Shown::at(Glance { worlds: &*world, instance: 0 });
            let now = now.behind(Some(&before), None);
            assert!(now.state.cells.len() < 10, "{:?}", now.state.cells);
            let mut cells = before.cells.clone();
            for (number, cell) in &now.state.cells {
                assert_ne!(cells[*number], *cell);
                cells[*number] = cell.clone();
            }
            assert_eq!(cells, now.cells);
            before = now;
        }
    }
}
