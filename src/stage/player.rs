//! A team in its world that people watch, and interfere with, episode after episode of a seed.

use alloc::collections::BTreeMap;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;
use core::cell::RefCell;

use serde::Serialize;
use sortie_core::wire::FrameMut;
use sortie_core::world::{Shape, StepOutcome, UnavailableAction, World};
use sortie_envs::random::episode;
use sortie_envs::{Choice, Environment, EnvironmentError, Split, StateError};

use crate::cast::Cast;
use crate::error::StageError;
use crate::memory::Memory;
use crate::show::{Glance, Show, Shown};
use crate::stage::{Moment, Stage};
use crate::thoughts::Thought;
use crate::utilities::UtilityHash;
use crate::world::EnvironmentWorld;

/// A team that plays episodes of a seed.
pub struct Player<'a, S: Show> {
    stage: Stage<'a, Episodes<S>>,
    facts: S::Facts,
    /// Number of the state that is shown.
    at: usize,
    before: Option<Shown<S>>,
    now: Shown<S>,
    is_over: bool,
    /// Absent agents, and the number of the state since when.
    absent: BTreeMap<usize, usize>,
    rehearsed: UtilityHash,
    decisions: u64,
}

/// What a page shows first.
#[derive(Serialize)]
#[serde(bound = "")]
pub struct Opening<'p, S: Show> {
    #[serde(flatten)]
    facts: &'p S::Facts,
    /// Steps after which an episode times out.
    limit: u32,
    /// Who may allocate, by name; nobody where agents are not assigned.
    allocators: Vec<&'static str>,
    #[serde(flatten)]
    news: News<S>,
}

/// A state that is new, or has changed.
#[derive(Serialize)]
#[serde(bound = "")]
pub struct News<S: Show> {
    at: usize,
    /// What led to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    step: Option<S::Step>,
    state: Decided<S>,
    events: Vec<S::Event>,
    /// Where the episode is over.
    #[serde(skip_serializing_if = "Option::is_none")]
    result: Option<&'static str>,
}

/// A state with what the team thinks, and is about to do in it.
#[derive(Serialize)]
#[serde(bound = "")]
struct Decided<S: Show> {
    #[serde(flatten)]
    state: S::State,
    /// `[A]`: what each agent thinks, none of agents that do not decide; none of final states.
    #[serde(skip_serializing_if = "Option::is_none")]
    thoughts: Option<Vec<Option<Thought>>>,
    /// `[A]`: what each agent has decided to do; none of those that decide nothing.
    chosen: Vec<Option<u16>>,
    /// Agents without a process.
    dead: Vec<usize>,
    /// Agents for which nobody has acted for some states, so that they are left out of allocations, and the number of the
    /// state since when.
    absent: Vec<(usize, usize)>,
}

/// Memory for a team in the worlds of an environment.
///
/// # Errors
/// The plans are damaged, or the team is for other worlds.
pub fn memory<S: Show>(cast: &Cast) -> Result<Memory, StageError> {
    Memory::new(cast, S::entry(), Episodes::<S>::new(&cast.set, 0, 0)?.shape())
}

impl<'a, S: Show> Player<'a, S> {
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
        let mut stage = Stage::new(memory, cast, Episodes::new(&cast.set, seed, episode)?, seed)?;
        stage.go_on()?;
        let (facts, state) = stage.world.with(|seen| (S::facts(seen), S::state(seen)));
        let now = Shown { step: None, state };
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
    pub fn open(&mut self) -> Result<Opening<'_, S>, StageError> {
        self.stage.attend();
        self.stage.look_again()?;
        let news = self.news()?;
        let rules = S::entry().rules.iter().map(|rule| rule.name);
        let allocators = ["learned"].into_iter().chain(rules);
        let limit = self.stage.world.with(|seen| seen.worlds.spec().episode_limit);
        let assigns = !self.stage.allocation().is_empty();
        let allocators = if assigns { allocators.collect() } else { Vec::new() };
        Ok(Opening { facts: &self.facts, limit, allocators, news })
    }

    /// Takes the next step; none where the episode is over.
    ///
    /// # Errors
    /// A role ended.
    pub fn step(&mut self) -> Result<Option<News<S>>, StageError> {
        if self.is_over {
            return Ok(None);
        }
        let moment = self.stage.go_on()?;
        let Some(Stepped { shown, result }) = self.stage.world.stepped.take() else {
            return Ok(None);
        };
        self.at += 1;
        self.is_over = moment == Moment::Over;
        self.before = Some(core::mem::replace(&mut self.now, shown));
        let news = self.news()?;
        Ok(Some(News { step: self.now.step.clone(), result, ..news }))
    }

    /// Puts an agent, or a thing behind the agents, elsewhere.
    ///
    /// # Errors
    /// Why it cannot be there.
    pub fn place(&mut self, entity: usize, place: [f64; 2]) -> Result<News<S>, String> {
        self.change(|worlds| {
            worlds.place(0, entity, place).map_err(|error| match error {
                StateError::Impossible(reason) => reason,
                error => error.to_string(),
            })
        })
    }

    /// Does to a thing what may come about by chance as well.
    ///
    /// # Errors
    /// Why nothing comes of it.
    pub fn disturb(&mut self, thing: usize) -> Result<News<S>, String> {
        self.change(|worlds| S::disturb(worlds, 0, thing))
    }

    /// Ends the process of an agent, or starts one where it has none.
    ///
    /// # Errors
    /// The episode is over, or a role ended.
    pub fn kill_or_revive(&mut self, agent: usize) -> Result<News<S>, String> {
        self.check_running()?;
        if self.stage.lives(agent) {
            self.stage.kill(agent);
        } else {
            self.stage.revive(agent).map_err(|error| error.to_string())?;
        }
        self.look_again()
    }

    /// Has somebody else allocate, by the place in the opening's list.
    ///
    /// # Errors
    /// The episode is over, or a role ended.
    pub fn choose_allocator(&mut self, choice: usize) -> Result<News<S>, String> {
        self.check_running()?;
        self.stage.choose_allocator(choice);
        self.look_again()
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
    ) -> Result<News<S>, String> {
        self.check_running()?;
        self.stage.world.change(change)?;
        self.look_again()
    }

    fn look_again(&mut self) -> Result<News<S>, String> {
        let again = self.stage.look_again().and_then(|()| self.news());
        again.map_err(|error| error.to_string())
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
    fn news(&mut self) -> Result<News<S>, StageError> {
        if !self.is_over {
            self.now.state = self.stage.world.with(S::state);
            S::assign(&mut self.now.state, &mut self.stage)?;
        }
        let agents = S::agents(&self.facts);
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
        let events = S::events(&self.facts, self.at, self.before.as_ref(), &self.now);
        let dead = (0..agents).filter(|agent| !self.stage.lives(*agent)).collect();
        let (state, thoughts) = (self.now.state.clone(), (!self.is_over).then_some(thoughts));
        let absent = self.absent(agents);
        let state = Decided { state, thoughts, chosen, dead, absent };
        Ok(News { at: self.at, step: None, state, events, result: None })
    }
}

/// Worlds, each the start of the next episode of a seed.
struct Episodes<S: Show> {
    world: EnvironmentWorld,
    seed: u64,
    next: usize,
    /// The newest step, until it is taken.
    stepped: Option<Stepped<S>>,
    /// Room for a state.
    state: RefCell<Vec<u8>>,
}

/// A step with the state that it led to.
struct Stepped<S: Show> {
    shown: Shown<S>,
    /// Where the episode is over.
    result: Option<&'static str>,
}

impl<S: Show> Episodes<S> {
    /// The starts of a set that are measured on, from episode `first` of `seed` on.
    fn new(set: &str, seed: u64, first: usize) -> Result<Self, EnvironmentError> {
        let choice =
            Choice { set: Some(set), split: Split::Test, instances: 1, settings: &BTreeMap::new() };
        let environment = (S::entry().open)(&choice)?;
        let world = EnvironmentWorld::not_begun(environment, episode(seed, first).0);
        Ok(Self { world, seed, next: first, stepped: None, state: RefCell::default() })
    }

    /// Calls `with` on the running episode.
    fn with<T>(&self, with: impl FnOnce(Glance<'_>) -> T) -> T {
        let (environment, mut state) = (self.world.environment.borrow(), self.state.borrow_mut());
        with(Glance::at(&**environment, 0, &mut state))
    }

    /// Changes the running episode.
    fn change<E>(
        &self,
        change: impl FnOnce(&mut dyn Environment) -> Result<(), E>,
    ) -> Result<(), E> {
        change(&mut **self.world.environment.borrow_mut())
    }
}

impl<S: Show> World for Episodes<S> {
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
        let before = self.with(S::state);
        let outcome = self.world.step(actions)?;
        let reward = self.world.last_step().reward;
        self.stepped = Some(self.with(|seen| {
            let state = S::state(seen);
            let step = Some(S::step(seen, actions, reward, [&before, &state]));
            let ended = outcome.episode_ended.then(|| seen.worlds.episode(seen.instance));
            let result = ended.map(|episode| S::result(&episode));
            Stepped { shown: Shown { step, state }, result }
        }));
        Ok(outcome)
    }
}
