//! Watches an episode and writes it down.

use std::any::Any;
use std::path::Path;

use sortie_envs::save_the_city::golden::{self, Playback};
use sortie_envs::save_the_city::{MAX_AGENTS, SaveTheCity, with_city};
use sortie_envs::{DecisionPoints, Environment, Random, UNASSIGNED};
use sortie_learn::play::{Onlooker, Watched};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::subtasks::AllocatedTeam;
use sortie_learn::{Act, LearnError, Scene, Scenes};
use sortie_stage::save_the_city::{
    AgentFacts, BuildingFacts, EpisodeResult, State, Step, agent_facts, building_facts, result,
    state, step,
};

use super::values::TeamValueProbe;
use crate::failure::{Failure, Outcome};
use crate::replay;
use crate::views::captured::{Thought, told};

/// An episode as it went.
pub(super) struct Captured {
    pub(super) agents: Vec<AgentFacts>,
    pub(super) buildings: Vec<BuildingFacts>,
    pub(super) states: Vec<State>,
    pub(super) steps: Vec<Step>,
    pub(super) result: EpisodeResult,
}

/// Has a team go through an episode and writes it down, with what the team and the allocator think.
pub(super) fn capture(
    team: AllocatedTeam<'_>,
    probe: Option<TeamValueProbe<'_>>,
    interval: u32,
    play: impl FnOnce(&mut StateLog<'_>, &mut StepLog) -> Outcome,
) -> Result<Captured, Failure> {
    let mut states = StateLog { team, probe, states: Vec::new() };
    let mut steps = StepLog { decisions: DecisionPoints::every(interval), ..StepLog::default() };
    play(&mut states, &mut steps)?;
    let StateLog { mut states, .. } = states;
    for (state, decided) in states.iter_mut().zip(&steps.decided) {
        state.decided = *decided;
    }
    states.extend(steps.last_state);
    let StepLog { agents, buildings, steps, result, .. } = steps;
    let result = result.unwrap_or(EpisodeResult::TimedOut);
    Ok(Captured { agents, buildings, states, steps, result })
}

impl Captured {
    /// Gives the states what was thought in them: agent by agent, state by state; none in the last.
    pub(super) fn give_thoughts(&mut self, thoughts: Vec<Thought>) {
        let mut thoughts = thoughts.into_iter();
        for state in &mut self.states {
            let own: Vec<_> = thoughts.by_ref().take(state.places.len()).map(Some).collect();
            state.thoughts = (!own.is_empty()).then_some(own);
        }
    }
}

/// A team whose every state is written down.
pub(super) struct StateLog<'a> {
    team: AllocatedTeam<'a>,
    probe: Option<TeamValueProbe<'a>>,
    states: Vec<State>,
}

impl Act for StateLog<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let Self { team, probe, states } = self;
        team.act(scenes, random, actions)?;
        let environment = scenes.environment;
        let mut thoughts = team.thoughts(scenes, actions).into_iter();
        for Scene { state: saved, instance, .. } in scenes.scenes {
            let allocation = team.allocation(*instance);
            let mut state = with_city(saved, |city| state(city, allocation));
            let values = probe.as_mut().map(|probe| probe.values(environment, saved, allocation));
            state.values = values.transpose()?;
            let own: Vec<_> =
                thoughts.by_ref().take(allocation.len()).map(|it| Some(told(it))).collect();
            let own = own.into_iter().take(state.places.len()).collect::<Vec<_>>();
            state.thoughts = (!own.is_empty()).then_some(own);
            states.push(state);
        }
        Ok(())
    }

    fn allocation(&self, instance: usize) -> &[u8] {
        self.team.allocation(instance)
    }
}

/// An onlooker that writes down every step.
#[derive(Default)]
pub(super) struct StepLog {
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

/// Goes through a recorded episode: its actions stand, whatever the team that is asked would do.
pub(super) fn play_again(
    playback: &mut Playback,
    team: &mut StateLog<'_>,
    onlooker: &mut StepLog,
) -> Outcome {
    fn watched(playback: &Playback) -> Watched<'_> {
        Watched { episode: 0, worlds: playback.world(), instance: 0 }
    }
    onlooker.started(watched(playback))?;
    let mut state = Vec::new();
    let (mut begins, mut tasks_changed) = (true, false);
    // No allocator that can be asked again draws from it.
    let mut unused = [generator(0, Purpose::Evaluation, 0)];
    while let Some(actions) = playback.next_actions().map(<[u16]>::to_vec) {
        let environment: &dyn Environment = playback.world();
        state.clear();
        environment.save(0, &mut state);
        let scene = Scene { instance: 0, state: &state, begins, tasks_changed };
        let scenes = Scenes { environment, scenes: &[scene] };
        let mut chosen = vec![0; environment.spec().shape.agents];
        team.act(&scenes, &mut unused, &mut chosen)?;
        team.team.did(0, &actions);
        let Some(outcome) = playback.step().map_err(Failure::bug)? else { break };
        onlooker.stepped(watched(playback), &actions, &outcome)?;
        (begins, tasks_changed) = (false, outcome.tasks_changed);
    }
    Ok(())
}
