//! Watches an episode and writes it down.

use std::any::Any;
use std::path::Path;

use sortie_envs::save_the_city::golden::{self, Playback};
use sortie_envs::save_the_city::{MAX_AGENTS, SaveTheCity, with_city};
use sortie_envs::{DecisionPoints, EntitySet, Environment, Observation, UNASSIGNED};
use sortie_learn::LearnError;
use sortie_learn::play::{Onlooker, Watched};
use sortie_learn::random::{Purpose, generator};
use sortie_methods::alma::agents::NO_ACTION;
use sortie_methods::alma::evaluate::{EvaluationPlan, watch_last_episode};
use sortie_methods::alma::teams::{Allocate, PolicyTeam, Scene, Team};
use sortie_nn::random::Generator;
use sortie_stage::save_the_city::{
    AgentFacts, BuildingFacts, EpisodeResult, State, Step, agent_facts, building_facts, result,
    state, step,
};

use super::values::TeamValueProbe;
use crate::failure::Failure;
use crate::replay;
use crate::views::captured::{Diary, Mind, Thought};

/// An episode as it went.
pub(super) struct Captured {
    pub(super) agents: Vec<AgentFacts>,
    pub(super) buildings: Vec<BuildingFacts>,
    pub(super) states: Vec<State>,
    pub(super) steps: Vec<Step>,
    pub(super) result: EpisodeResult,
}

/// Who is asked what it thinks.
pub(super) enum Thinker<'a> {
    /// Agents with utilities.
    Mind(&'a mut dyn Mind),
    /// A team that only acts.
    Silent(&'a mut dyn Team),
}

/// Goes through an episode and writes it down, with what the team and the allocator think.
pub(super) fn capture(
    episode: &mut dyn Episode,
    thinker: Thinker<'_>,
    probe: Option<TeamValueProbe<'_>>,
    interval: u32,
) -> Result<Captured, Failure> {
    let mut steps = StepLog { decisions: DecisionPoints::every(interval), ..StepLog::default() };
    let (mut states, thoughts) = match thinker {
        Thinker::Mind(mind) => {
            let mut diary = Diary::new(mind);
            let states = play(episode, &mut PolicyTeam::new(&mut diary), probe, &mut steps)?;
            (states, diary.thoughts)
        }
        Thinker::Silent(team) => (play(episode, team, probe, &mut steps)?, Vec::new()),
    };
    give_thoughts(&mut states, thoughts);
    for (state, decided) in states.iter_mut().zip(&steps.decided) {
        state.decided = *decided;
    }
    states.extend(steps.last_state);
    let StepLog { agents, buildings, steps, result, .. } = steps;
    let result = result.unwrap_or(EpisodeResult::TimedOut);
    Ok(Captured { agents, buildings, states, steps, result })
}

/// Goes through an episode and returns the states in which `team` acts.
fn play(
    episode: &mut dyn Episode,
    team: &mut dyn Team,
    probe: Option<TeamValueProbe<'_>>,
    steps: &mut StepLog,
) -> Result<Vec<State>, Failure> {
    let mut log = StateLog { team, probe, states: Vec::new() };
    episode.play(&mut log, steps)?;
    Ok(log.states)
}

/// Every decision was one agent's, agent by agent, state by state.
fn give_thoughts(states: &mut [State], thoughts: Vec<Thought>) {
    let mut thoughts = thoughts.into_iter();
    for state in states {
        let own: Vec<_> = thoughts.by_ref().take(state.places.len()).map(Some).collect();
        state.thoughts = (!own.is_empty()).then_some(own);
    }
}

/// A team that writes down every state in which it acts.
struct StateLog<'a> {
    team: &'a mut dyn Team,
    probe: Option<TeamValueProbe<'a>>,
    states: Vec<State>,
}

impl Team for StateLog<'_> {
    fn act(
        &mut self,
        scenes: &[Scene<'_>],
        actions: &mut [u16],
        agents: usize,
    ) -> Result<(), LearnError> {
        for scene in scenes {
            let mut state = with_city(scene.state, |city| state(city, scene.allocation));
            state.values = self.probe.as_mut().map(|probe| probe.values(scene)).transpose()?;
            self.states.push(state);
        }
        self.team.act(scenes, actions, agents)
    }
}

/// An onlooker that writes down every step.
#[derive(Default)]
struct StepLog {
    agents: Vec<AgentFacts>,
    buildings: Vec<BuildingFacts>,
    decisions: DecisionPoints,
    /// Of every state but the last.
    decided: Vec<bool>,
    steps: Vec<Step>,
    /// The final state so far.
    last_state: Option<State>,
    result: Option<EpisodeResult>,
}

impl Onlooker for StepLog {
    fn started(&mut self, watched: Watched<'_>) -> Result<(), LearnError> {
        let city = cities(&watched)?.city(watched.instance);
        (self.agents, self.buildings) = (agent_facts(city), building_facts(city));
        self.decided.push(self.decisions.is_due(false));
        Ok(())
    }

    fn stepped(
        &mut self,
        watched: Watched<'_>,
        actions: &[u16],
        outcome: &sortie_envs::Step,
    ) -> Result<(), LearnError> {
        let (worlds, instance) = (cities(&watched)?, watched.instance);
        self.steps.push(step(worlds, instance, actions, outcome.reward));
        if !outcome.done() {
            self.decided.push(self.decisions.is_due(outcome.tasks_changed));
        }
        self.last_state = Some(state(worlds.city(instance), &[UNASSIGNED; MAX_AGENTS]));
        self.result = Some(result(worlds.metrics(instance)));
        Ok(())
    }
}

/// The cities of an episode that is watched.
fn cities<'a>(watched: &Watched<'a>) -> Result<&'a SaveTheCity, LearnError> {
    let worlds: &dyn Any = watched.worlds;
    let elsewhere = || LearnError::Team("this page is made for another environment".to_owned());
    worlds.downcast_ref().ok_or_else(elsewhere)
}

/// An episode that a team goes through while somebody watches.
pub(super) trait Episode {
    /// Asks `team` in every state and tells `onlooker` what happens.
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure>;
}

/// An episode that the team itself plays: the last one of a plan.
pub(super) struct Played<'a> {
    pub(super) plan: &'a EvaluationPlan<'a>,
    pub(super) allocator: &'a mut dyn Allocate,
}

impl Episode for Played<'_> {
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure> {
        Ok(watch_last_episode(self.plan, team, self.allocator, onlooker)?)
    }
}

/// A recorded episode: its actions stand, whatever the team that is asked would do.
pub(super) struct Replayed<'a> {
    pub(super) playback: &'a mut Playback,
    /// Who assigned the agents, which recordings do not hold.
    pub(super) allocator: Option<&'a mut dyn Allocate>,
}

/// Reads a recording and checks that it replays bit for bit.
pub(super) fn open_recording(file: &Path, text: &str) -> Result<Playback, Failure> {
    let name = file.display().to_string();
    let unreadable = |error| replay::unreadable(error).within(&name);
    let replayed = golden::replay(&name, text).map_err(unreadable)?;
    match replayed.mismatches.first() {
        Some(first) => Err(replay::difference(first, replayed.mismatches.len())),
        None => Playback::new(text).map_err(unreadable),
    }
}

fn watched(playback: &Playback) -> Watched<'_> {
    Watched { episode: 0, worlds: playback.world(), instance: 0 }
}

impl Episode for Replayed<'_> {
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure> {
        onlooker.started(watched(self.playback))?;
        let mut decisions = DecisionPoints::default();
        let mut tasks_changed = false;
        let mut seen = Observation::default();
        let mut allocation = [UNASSIGNED; MAX_AGENTS];
        let mut last_actions = [NO_ACTION; MAX_AGENTS];
        // No allocator that can be asked again draws from it.
        let mut unused: Generator = generator(0, Purpose::Evaluation, 0);
        while let Some(actions) = self.playback.next_actions().map(<[u16]>::to_vec) {
            let environment: &dyn Environment = self.playback.world();
            let mut state = Vec::new();
            environment.save(0, &mut state);
            environment.observe(&state, 0, EntitySet::MAX, &mut seen);
            let due = decisions.is_due(tasks_changed);
            if let Some(allocator) = self.allocator.as_mut().filter(|_| due) {
                allocator.allocate(environment, &state, &mut unused, &mut allocation)?;
            }
            let scene = Scene {
                world: 0,
                environment,
                state: &state,
                seen: &seen,
                allocation: &allocation,
                last_actions: &last_actions,
                strategies: &[],
            };
            team.act(&[scene], &mut [0; MAX_AGENTS], MAX_AGENTS)?;
            let Some(outcome) = self.playback.step().map_err(Failure::bug)? else { break };
            onlooker.stepped(watched(self.playback), &actions, &outcome)?;
            for (last, action) in last_actions.iter_mut().zip(&actions) {
                *last = *action as u8;
            }
            tasks_changed = outcome.tasks_changed;
        }
        Ok(())
    }
}
