//! Watches an episode and keeps what its page shows.

use serde::Serialize;
use sortie_envs::{DecisionPoints, Environment, Split};
use sortie_learn::play::{Onlooker, Watched, watch};
use sortie_learn::{Act, Ask, LearnError};
use sortie_stage::{
    Cast, Event, Facts, Glance, Head, News, Opening, Player, Shown, StageError, State, Step,
    Thought, memory, result, rounded,
};

/// An episode as it went.
#[derive(Serialize)]
pub struct Captured {
    /// What does not change.
    #[serde(flatten)]
    pub facts: Facts,
    /// Rows of agents in what thoughts are given of.
    #[serde(skip)]
    slots: usize,
    /// One more than steps: the last one is final.
    pub states: Vec<State>,
    /// What happened between them.
    pub steps: Vec<Step>,
    /// What is worth jumping to.
    pub events: Vec<Event>,
    /// How it has ended.
    pub result: &'static str,
    /// `[agents, cells]`: how often each agent was where while it learned; empty where that is not known.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub visits: Vec<Vec<u32>>,
}

/// Has a team play an episode, given by its seed and number as evaluations count them, and keeps it, with what the team
/// thinks where it tells.
///
/// # Errors
/// The team cannot play here.
pub fn play(
    environment: &dyn Environment,
    seed: u64,
    number: usize,
    mut team: TeamLog<'_, dyn Act + '_>,
) -> Result<Captured, LearnError> {
    let (mut world, mut steps) = (environment.open(1, Split::Test), StepLog::default());
    watch(&mut *world, &mut team, number..number + 1, seed, &mut steps)?;
    Ok(team.captured(steps))
}

/// The same of a deployed team, each of whose agents has a process.
///
/// # Errors
/// The team is for other worlds.
pub fn play_deployed(cast: &Cast, seed: u64, number: usize) -> Result<Captured, StageError> {
    let mut memory = memory(cast)?;
    let mut player = Player::new(&mut memory, cast, seed, number)?;
    let Opening { facts, news, .. } = player.open()?;
    let (states, steps) = (vec![news.state.state], Vec::new());
    let events = news.events;
    let slots = facts.agents.len();
    let (result, visits) = ("", Vec::new());
    let mut captured = Captured { facts, slots, states, steps, events, result, visits };
    while let Some(News { step, state, events, result, .. }) = player.step()? {
        captured.states.push(state.state);
        captured.steps.extend(step);
        captured.events.extend(events);
        captured.result = result.unwrap_or_default();
    }
    Ok(captured)
}

impl Captured {
    /// Gives the states what was thought in them: agent by agent, state by state; none in the last.
    pub fn give_thoughts(&mut self, thoughts: Vec<Thought>) {
        let mut thoughts = thoughts.into_iter();
        for state in &mut self.states {
            state.thoughts = next_thoughts(&mut thoughts, self.slots, state.agents.len());
        }
    }

    /// Whether it is known what anybody thought.
    pub fn is_told(&self) -> bool {
        self.states.first().is_some_and(|state| state.thoughts.is_some())
    }
}

/// Tells what teams, bit a of which stands for agent a, are worth at an open subtask of a state; nothing where that is not
/// known.
type ValueTeams<'a> =
    dyn FnMut(&dyn Environment, &[u8], usize, &[u64]) -> Result<Vec<f32>, LearnError> + 'a;

/// Asks a network that values teams about those that are there, and about others.
pub struct TeamValueProbe<'a> {
    /// The network.
    pub ask: Box<ValueTeams<'a>>,
    /// Largest team that the allocator sends to one subtask.
    pub team_max: usize,
}

/// A team whose every state is kept, with what it thinks in it.
pub struct TeamLog<'a, T: ?Sized> {
    /// The team.
    pub team: &'a mut T,
    decisions: DecisionPoints,
    probe: Option<TeamValueProbe<'a>>,
    shown: Vec<Shown>,
    /// Rows of agents in observations, whether there are so many or not.
    slots: usize,
}

impl<'a, T: Act + ?Sized> TeamLog<'a, T> {
    /// A team whose agents are allocated every so many steps, where they are.
    pub fn new(team: &'a mut T, interval: u32, probe: Option<TeamValueProbe<'a>>) -> Self {
        let (decisions, shown) = (DecisionPoints::every(interval), Vec::new());
        Self { team, decisions, probe, shown, slots: 0 }
    }

    /// The episode, with its steps.
    ///
    /// # Panics
    /// No episode was played.
    pub fn captured(self, log: StepLog) -> Captured {
        let StepLog { facts, steps, last, result } = log;
        let facts = facts.expect("an episode begins before it ends");
        let visits = self.team.visits();
        let mut shown: Vec<Shown> = Vec::new();
        let mut led = steps.iter().cloned();
        for state in self.shown.into_iter().chain(last) {
            let step = if shown.is_empty() { None } else { led.next() };
            let state = state.behind(shown.last(), step);
            shown.push(state);
        }
        let before = |at: usize| at.checked_sub(1).and_then(|before| shown.get(before));
        let events = shown.iter().enumerate();
        let events = events.flat_map(|(at, now)| now.events(&facts, at, before(at))).collect();
        let states = shown.into_iter().map(|shown| shown.state).collect();
        Captured { facts, slots: self.slots, states, steps, events, result, visits }
    }
}

impl<T: Act + ?Sized> Act for TeamLog<'_, T> {
    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>) -> Result<(), LearnError> {
        self.team.act(Ask { scenes, random, actions })?;
        let worlds = scenes.environment;
        self.slots = worlds.spec().shape.agents;
        let mut thoughts = self.team.thoughts(scenes, actions).into_iter().map(told);
        for scene in scenes.scenes {
            let mut shown = Shown::at(Glance { worlds, instance: scene.instance });
            let decided = self.decisions.is_due(scene.tasks_changed);
            shown.assign(self.team.allocation(scene.instance), decided);
            let agents = shown.state.agents.len();
            shown.state.thoughts = next_thoughts(&mut thoughts, self.slots, agents);
            if let Some(TeamValueProbe { ask, team_max }) = &mut self.probe {
                let values = shown
                    .team_values(*team_max, 0, |task, teams| ask(worlds, scene.state, task, teams));
                shown.state.values = Some(values?);
            }
            self.shown.push(shown);
        }
        Ok(())
    }

    fn allocation(&self, instance: usize) -> &[u8] {
        self.team.allocation(instance)
    }
}

/// The next thoughts, one for each agent; none where nobody thinks. Observations have rows for agents that do not exist,
/// `slots` in all; pages do not.
fn next_thoughts(
    thoughts: &mut impl Iterator<Item = Thought>,
    slots: usize,
    agents: usize,
) -> Option<Vec<Option<Thought>>> {
    let renumbered = |mut thought: Thought| {
        for attended in thought.attention.iter_mut().filter(|it| it.entity >= slots) {
            attended.entity -= slots - agents;
        }
        Some(thought)
    };
    let own: Vec<_> = thoughts.take(agents).map(renumbered).collect();
    (!own.is_empty()).then_some(own)
}

/// A thought as pages have it.
fn told(thought: sortie_learn::Thought) -> Thought {
    let head = |sortie_learn::Head { name, pays, likes, acts }| Head {
        name,
        pays: rounded(pays),
        likes,
        acts,
    };
    Thought {
        heads: thought.heads.into_iter().map(head).collect(),
        ..Thought::new(&thought.scores, thought.attention)
    }
}

/// An onlooker that keeps every step, and the last state.
#[derive(Default)]
pub struct StepLog {
    facts: Option<Facts>,
    steps: Vec<Step>,
    last: Option<Shown>,
    result: &'static str,
}

impl Onlooker for StepLog {
    fn started(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        self.facts = Some(Facts::at(glance(&watched)));
        Ok(())
    }

    fn stepped(
        &mut self,
        watched: Watched<'_>,
        actions: &[u16],
        outcome: &sortie_envs::Step,
    ) -> Result<(), LearnError> {
        let seen = glance(&watched);
        self.steps.push(Step::at(seen, actions, outcome.reward));
        if outcome.done() {
            self.last = Some(Shown::at(seen));
            self.result = result(seen.worlds.spec(), &seen.worlds.episode(seen.instance));
        }
        Ok(())
    }
}

fn glance<'a>(watched: &Watched<'a>) -> Glance<'a> {
    Glance { worlds: watched.worlds, instance: watched.instance }
}
