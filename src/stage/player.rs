//! A team in its world that people watch, and interfere with, episode after episode of a seed.

use alloc::collections::BTreeMap;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;

use serde::Serialize;
use sortie_core::wire::FrameMut;
use sortie_core::world::{Shape, StepOutcome, UnavailableAction, World};
use sortie_envs::random::episode;
use sortie_envs::{Choice, ENVIRONMENTS, Entry, Environment, EnvironmentError, Split, StateError};

use crate::cast::Cast;
use crate::error::StageError;
use crate::memory::Memory;
use crate::show::{Event, Facts, Glance, Shown, State, Step, result};
use crate::stage::{Moment, Stage};
use crate::thoughts::Thought;
use crate::utilities::UtilityHash;
use crate::world::EnvironmentWorld;

/// A team that plays episodes of a seed.
pub struct Player<'a> {
    stage: Stage<'a, Episodes>,
    facts: Facts,
    /// Number of the state that is shown.
    at: usize,
    before: Option<Shown>,
    now: Shown,
    is_over: bool,
    /// Absent agents, and the number of the state since when.
    absent: BTreeMap<usize, usize>,
    rehearsed: UtilityHash,
    decisions: u64,
}

/// What a page shows first.
#[derive(Serialize)]
pub struct Opening {
    /// What does not change.
    #[serde(flatten)]
    pub facts: Facts,
    /// Who may allocate, by name; nobody where agents are not assigned.
    pub allocators: Vec<String>,
    /// The first state.
    #[serde(flatten)]
    pub news: News,
}

/// A state that is new, or has changed.
#[derive(Serialize)]
pub struct News {
    /// Its number.
    pub at: usize,
    /// What led to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<Step>,
    /// The state, with what the team thinks in it.
    pub state: Decided,
    /// What is worth jumping to.
    pub events: Vec<Event>,
    /// Where the episode is over.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub result: Option<&'static str>,
}

/// A state with what the team is about to do in it.
#[derive(Serialize)]
pub struct Decided {
    /// The state.
    #[serde(flatten)]
    pub state: State,
    /// `[A]`: what each agent has decided to do; none of those that decide nothing.
    chosen: Vec<Option<u16>>,
    /// Agents without a process.
    dead: Vec<usize>,
    /// Agents for which nobody has acted for some states, so that they are left out of allocations, and the number of the
    /// state since when.
    absent: Vec<(usize, usize)>,
}

/// Memory for a team in the worlds of its environment.
///
/// # Errors
/// The plans are damaged, or the team is for other worlds.
pub fn memory(cast: &Cast) -> Result<Memory, StageError> {
    Memory::new(cast, entry(cast)?, Episodes::new(cast, 0, 0)?.shape())
}

/// How the environment of a team is found.
fn entry(cast: &Cast) -> Result<&'static Entry, EnvironmentError> {
    let found = ENVIRONMENTS.iter().find(|entry| entry.name == cast.environment);
    found.ok_or_else(|| EnvironmentError::Set(cast.environment.clone()))
}

impl<'a> Player<'a> {
    /// Begins an episode of a seed, and decides in its first state.
    ///
    /// # Errors
    /// The team is for other worlds.
    pub fn new(
        memory: &'a mut Memory,
        cast: &Cast,
        seed: u64,
        episode: usize,
    ) -> Result<Self, StageError> {
        let mut stage = Stage::new(memory, cast, Episodes::new(cast, seed, episode)?, seed)?;
        stage.go_on()?;
        let (facts, now) = (stage.world.with(Facts::at), stage.world.with(Shown::at));
        Ok(Self {
            stage,
            facts,
            at: 0,
            before: None,
            now,
            is_over: false,
            absent: BTreeMap::new(),
            rehearsed: UtilityHash::default(),
            decisions: 0,
        })
    }

    /// What to show first, and what agents think from then on.
    ///
    /// # Errors
    /// A role ended.
    pub fn open(&mut self) -> Result<Opening, StageError> {
        self.stage.attend();
        let news = self.look_again()?;
        let mut allocators = Vec::new();
        if !self.stage.allocation().is_empty() {
            allocators.push("learned".into());
            self.stage.world.with(|seen| {
                let rules = seen.worlds.spec().rules.iter();
                allocators.extend(rules.map(|rule| rule.name.to_string()));
            });
        }
        Ok(Opening { facts: self.facts.clone(), allocators, news })
    }

    /// Takes the next step; none where the episode is over.
    ///
    /// # Errors
    /// A role ended.
    pub fn step(&mut self) -> Result<Option<News>, StageError> {
        if self.is_over {
            return Ok(None);
        }
        let moment = self.stage.go_on()?;
        let Some(Stepped { step, last, result }) = self.stage.world.stepped.take() else {
            return Ok(None);
        };
        self.at += 1;
        self.is_over = moment == Moment::Over;
        let shown = last.unwrap_or_else(|| self.stage.world.with(Shown::at));
        let shown = shown.behind(Some(&self.now), Some(step.clone()));
        self.before = Some(core::mem::replace(&mut self.now, shown));
        let news = self.news()?;
        Ok(Some(News { step: Some(step), result, ..news }))
    }

    /// Puts an agent, or a thing behind the agents, elsewhere.
    ///
    /// # Errors
    /// Why it cannot be there.
    pub fn place(&mut self, entity: usize, place: [f64; 2]) -> Result<News, String> {
        self.change(|worlds| worlds.place(0, entity, place).map_err(|error| reason(&error)))
    }

    /// Does to a thing what may come about by chance as well.
    ///
    /// # Errors
    /// Why nothing comes of it.
    pub fn disturb(&mut self, thing: usize) -> Result<News, String> {
        self.change(|worlds| worlds.disturb(0, thing).map_err(|error| reason(&error)))
    }

    /// Ends the process of an agent, or starts one where it has none.
    ///
    /// # Errors
    /// The episode is over, or a role ended.
    pub fn kill_or_revive(&mut self, agent: usize) -> Result<News, String> {
        self.check_running()?;
        if self.stage.lives(agent) {
            self.stage.kill(agent);
        } else {
            self.stage.revive(agent).map_err(|error| error.to_string())?;
        }
        self.look_again().map_err(|error| error.to_string())
    }

    /// Has somebody else allocate, by the place in the opening's list.
    ///
    /// # Errors
    /// The episode is over, or a role ended.
    pub fn choose_allocator(&mut self, choice: usize) -> Result<News, String> {
        self.check_running()?;
        self.stage.choose_allocator(choice);
        self.look_again().map_err(|error| error.to_string())
    }

    /// Computes an agent's decision once more; false where it decides nothing.
    ///
    /// # Errors
    /// The plan refuses what it has taken before.
    pub fn repeat_decision(&mut self, agent: usize) -> Result<bool, StageError> {
        self.stage.repeat_decision(agent)
    }

    /// Plays on, episode after episode, without showing anything, and counts the decisions of the state before. Returns how
    /// many there have been, `most` at most.
    ///
    /// # Errors
    /// A role ended.
    pub fn rehearse(&mut self, most: u64) -> Result<u64, StageError> {
        for note in self.stage.notes() {
            if self.decisions < most {
                self.rehearsed.add(&note.utilities);
                self.decisions += 1;
            }
        }
        self.stage.go_on()?;
        Ok(self.decisions)
    }

    /// The hash of all utilities that were counted.
    pub fn rehearsed(&self) -> u64 {
        self.rehearsed.value()
    }

    fn check_running(&self) -> Result<(), String> {
        if self.is_over { Err("the episode is over".to_string()) } else { Ok(()) }
    }

    fn change(
        &mut self,
        change: impl FnOnce(&mut dyn Environment) -> Result<(), String>,
    ) -> Result<News, String> {
        self.check_running()?;
        self.stage.world.change(change)?;
        self.look_again().map_err(|error| error.to_string())
    }

    /// Everybody looks and decides anew, and so is the state shown anew.
    fn look_again(&mut self) -> Result<News, StageError> {
        self.stage.look_again()?;
        let (step, now) = (self.now.step.take(), self.stage.world.with(Shown::at));
        self.now = now.behind(self.before.as_ref(), step);
        self.news()
    }

    /// Who is absent in the state that is shown, and since which state.
    fn absent(&mut self, agents: usize) -> Vec<(usize, usize)> {
        for agent in 0..agents {
            if self.stage.is_absent(agent) {
                self.absent.entry(agent).or_insert(self.at);
            } else {
                self.absent.remove(&agent);
            }
        }
        self.absent.iter().map(|(agent, since)| (*agent, *since)).collect()
    }

    /// The state that is shown, with what the team thinks in it.
    fn news(&mut self) -> Result<News, StageError> {
        let agents = self.facts.agents.len();
        if !self.is_over {
            self.assign()?;
        }
        let (mut thoughts, mut chosen) = (vec![None; agents], vec![None; agents]);
        for note in self.stage.notes().iter().filter(|note| note.agent < agents) {
            let slots = self.stage.slots();
            let attention = note.attention.iter().map(|(row, weights)| {
                // Frames have rows for agents that do not exist; pages do not.
                let missing = if *row < slots { 0 } else { slots - agents };
                (row - missing, weights.clone())
            });
            let thought = Thought::new(&note.utilities, attention.collect());
            thoughts[note.agent] = Some(Thought { option: note.option.clone(), ..thought });
            chosen[note.agent] = note.action;
        }
        self.now.state.thoughts = (!self.is_over).then_some(thoughts);
        let events = self.now.events(&self.facts, self.at, self.before.as_ref());
        let dead = (0..agents).filter(|agent| !self.stage.lives(*agent)).collect();
        let (state, absent) = (self.now.state.clone(), self.absent(agents));
        let state = Decided { state, chosen, dead, absent };
        Ok(News { at: self.at, step: None, state, events, result: None })
    }

    /// Notes who is assigned where, and what teams are worth.
    fn assign(&mut self) -> Result<(), StageError> {
        let Self { stage, now, .. } = self;
        if stage.allocation().is_empty() {
            return Ok(());
        }
        now.assign(stage.allocation(), stage.is_allocated_anew());
        let absent = (0..stage.slots()).filter(|agent| stage.is_absent(*agent));
        let absent = absent.fold(0, |set, agent| set | 1_u64 << agent);
        let values = now.team_values(stage.team_max(), absent, |task, teams| {
            stage.team_values(task, teams).map(Option::unwrap_or_default)
        });
        now.state.values = Some(values?);
        Ok(())
    }
}

/// Why something cannot be, without saying so twice.
fn reason(error: &StateError) -> String {
    match error {
        StateError::Impossible(reason) => reason.clone(),
        error => error.to_string(),
    }
}

/// Worlds, each the start of the next episode of a seed.
struct Episodes {
    world: EnvironmentWorld,
    seed: u64,
    next: usize,
    /// The newest step, until it is taken.
    stepped: Option<Stepped>,
}

/// A step, with the state that it led to where the episode is over.
struct Stepped {
    step: Step,
    last: Option<Shown>,
    result: Option<&'static str>,
}

impl Episodes {
    /// The starts of a set that are measured on, from episode `first` of `seed` on.
    fn new(cast: &Cast, seed: u64, first: usize) -> Result<Self, EnvironmentError> {
        let (set, settings) = (Some(&cast.set[..]), &BTreeMap::new());
        let choice = Choice { set, split: Split::Test, instances: 1, settings };
        let environment = (entry(cast)?.open)(&choice)?;
        let world = EnvironmentWorld::not_begun(environment, episode(seed, first).0);
        Ok(Self { world, seed, next: first, stepped: None })
    }

    /// Calls `with` on the running episode.
    fn with<T>(&self, with: impl FnOnce(Glance<'_>) -> T) -> T {
        with(Glance { worlds: &**self.world.environment.borrow(), instance: 0 })
    }

    /// Changes the running episode.
    fn change<E>(
        &self,
        change: impl FnOnce(&mut dyn Environment) -> Result<(), E>,
    ) -> Result<(), E> {
        change(&mut **self.world.environment.borrow_mut())
    }
}

impl World for Episodes {
    fn shape(&self) -> Shape {
        self.world.shape()
    }

    fn reset(&mut self) {
        self.world.draw_from(episode(self.seed, self.next).0);
        self.next += 1;
        self.world.reset();
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        self.world.observe(frame);
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        let outcome = self.world.step(actions)?;
        let reward = self.world.last_step().reward;
        self.stepped = Some(self.with(|seen| {
            let ended = outcome.episode_ended.then(|| seen.worlds.episode(seen.instance));
            Stepped {
                step: Step::at(seen, actions, reward),
                last: ended.is_some().then(|| Shown::at(seen)),
                result: ended.map(|episode| result(seen.worlds.spec(), &episode)),
            }
        }));
        Ok(outcome)
    }
}
