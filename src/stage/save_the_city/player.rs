//! A team in a city that people watch, and interfere with.

use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Serialize;
use sortie_attention::AttentionProbe;
use sortie_core::World;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_envs::save_the_city::{ACTION_NAMES, CityError, ENTRY, FEATURES, SIDE, SaveTheCity};

use super::cities::{Cities, Stepped};
use super::data::{AgentFacts, BuildingFacts, EpisodeResult, Event, State, Step, TeamValues};
use super::events::Names;
use super::facts::{agent_facts, building_facts, state};
use super::values::candidates;
use crate::cast::Cast;
use crate::error::StageError;
use crate::memory::Memory;
use crate::stage::{Moment, Stage};
use crate::thoughts::Thought;
use crate::utilities::{UtilityHash, hash_of};

/// A team that plays episodes of a seed.
pub struct Player<'a> {
    stage: Stage<'a, Cities>,
    team_max: usize,
    agents: Vec<AgentFacts>,
    buildings: Vec<BuildingFacts>,
    /// Number of the state that is shown.
    at: usize,
    before: Option<State>,
    now: State,
    is_over: bool,
    rehearsed: UtilityHash,
    decisions: u64,
}

/// What a page shows first.
#[derive(Debug, Serialize)]
pub struct Opening<'p> {
    side: u8,
    actions: &'static [&'static str],
    agents: &'p [AgentFacts],
    buildings: &'p [BuildingFacts],
    /// Steps after which an episode times out.
    limit: u32,
    /// Who may allocate, by name.
    allocators: Vec<&'static str>,
    #[serde(flatten)]
    news: News,
}

/// A state that is new, or has changed.
#[derive(Debug, Serialize)]
pub struct News {
    at: usize,
    /// What led to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    step: Option<Step>,
    state: Shown,
    events: Vec<Event>,
    /// Where the episode is over.
    #[serde(skip_serializing_if = "Option::is_none")]
    result: Option<EpisodeResult>,
}

/// A state with what the team is about to do in it.
#[derive(Debug, Serialize)]
struct Shown {
    #[serde(flatten)]
    state: State,
    /// `[A]`: what each agent has decided to do; none of those that decide nothing.
    chosen: Vec<Option<u16>>,
    /// Agents without a process.
    dead: Vec<usize>,
}

/// Memory for a team in cities.
///
/// # Errors
/// The plans are damaged, or the team is for other cities.
pub fn memory(cast: &Cast) -> Result<Memory, StageError> {
    Memory::new(cast, &ENTRY, Cities::new(&cast.set, 0, 0)?.shape())
}

/// The hash of all utilities of a team's golden observations.
///
/// # Errors
/// The plan is damaged, or for other observations.
pub fn golden_hash(cast: &Cast) -> Result<u64, StageError> {
    let plan = AlignedBytes::copy_of(&cast.agent);
    let plan = Plan::load(plan.as_slice())?;
    let rows: Vec<Vec<f32>> = cast.golden.iter().map(|seen| seen.dense()).collect();
    let seen = cast.golden.iter().zip(&rows).map(|(seen, rows)| seen.view(rows));
    Ok(hash_of(&plan, seen)?)
}

impl<'a> Player<'a> {
    /// Begins an episode of a seed, and decides in its first state.
    ///
    /// # Errors
    /// The team is for other cities.
    pub fn new(
        memory: &'a mut Memory,
        cast: &Cast,
        seed: u64,
        episode: usize,
    ) -> Result<Self, StageError> {
        let cities = Cities::new(&cast.set, seed, episode)?;
        let mut stage = Stage::new(memory, cast, cities, seed)?;
        stage.go_on()?;
        let (agents, buildings, now) = stage.world.with(|cities| {
            let city = cities.city(0);
            (agent_facts(city), building_facts(city), state(city, stage.allocation()))
        });
        let (before, team_max) = (None, cast.team_max.into());
        let (at, is_over, rehearsed, decisions) = (0, false, UtilityHash::default(), 0);
        Ok(Self {
            stage,
            team_max,
            agents,
            buildings,
            at,
            before,
            now,
            is_over,
            rehearsed,
            decisions,
        })
    }

    /// What to show first, agents' attention included.
    ///
    /// # Errors
    /// A role ended.
    pub fn open(&mut self, cast: &Cast) -> Result<Opening<'_>, StageError> {
        self.stage.attend(AttentionProbe::new(cast.attention.clone(), FEATURES));
        self.stage.look_again()?;
        let news = self.news(None)?;
        let rules = ENTRY.rules.iter().map(|rule| rule.name);
        Ok(Opening {
            side: SIDE,
            actions: &ACTION_NAMES,
            agents: &self.agents,
            buildings: &self.buildings,
            limit: self.stage.world.with(|cities| cities.constants().episode_limit),
            allocators: ["learned"].into_iter().chain(rules).collect(),
            news,
        })
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
        let Some(Stepped { step, state, result }) = self.stage.world.take_step() else {
            return Ok(None);
        };
        self.at += 1;
        self.is_over = moment == Moment::Over;
        self.before = Some(core::mem::replace(&mut self.now, state));
        let news = self.news(Some(step))?;
        Ok(Some(News { result, ..news }))
    }

    /// Puts an agent on another cell.
    ///
    /// # Errors
    /// Why it cannot stand there.
    pub fn place(&mut self, agent: usize, place: (u8, u8)) -> Result<News, String> {
        self.change(|cities| cities.place_agent(0, agent, place))
    }

    /// Sets a building on fire.
    ///
    /// # Errors
    /// Why it cannot burn.
    pub fn set_fire(&mut self, building: usize) -> Result<News, String> {
        self.change(|cities| cities.set_fire(0, building))
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
        self.look_again()
    }

    /// Has somebody else allocate, by the place in the opening's list.
    ///
    /// # Errors
    /// The episode is over, or a role ended.
    pub fn choose_allocator(&mut self, choice: usize) -> Result<News, String> {
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
        change: impl FnOnce(&mut SaveTheCity) -> Result<(), CityError>,
    ) -> Result<News, String> {
        self.check_running()?;
        self.stage.world.change(change).map_err(|error| error.to_string())?;
        self.look_again()
    }

    fn look_again(&mut self) -> Result<News, String> {
        let again = self.stage.look_again().and_then(|()| self.news(None));
        again.map_err(|error| error.to_string())
    }

    /// The state that is shown, with what the team thinks in it.
    fn news(&mut self, step: Option<Step>) -> Result<News, StageError> {
        if !self.is_over {
            let allocation = self.stage.allocation();
            self.now = self.stage.world.with(|cities| state(cities.city(0), allocation));
            self.now.decided = self.stage.is_allocated_anew();
            self.now.values = Some(self.values()?);
        }
        let slots = self.stage.allocation().len();
        let (mut thoughts, mut chosen) = (Vec::new(), Vec::new());
        thoughts.resize(self.agents.len(), None);
        chosen.resize(self.agents.len(), None);
        for note in self.stage.notes().iter().filter(|note| note.agent < self.agents.len()) {
            let attention = note.attention.iter().map(|(row, weights)| {
                // Frames have rows for agents that do not exist; pages do not.
                let missing = if *row < slots { 0 } else { slots - self.agents.len() };
                (row - missing, weights.clone())
            });
            thoughts[note.agent] = Some(Thought::new(&note.utilities, attention.collect()));
            chosen[note.agent] = note.action;
        }
        self.now.thoughts = (!self.is_over).then_some(thoughts);
        let names = Names { agents: &self.agents, buildings: &self.buildings };
        let events = names.events_at(self.at, self.before.as_ref(), &self.now);
        let dead = (0..self.agents.len()).filter(|agent| !self.stage.lives(*agent)).collect();
        let state = Shown { state: self.now.clone(), chosen, dead };
        Ok(News { at: self.at, step, state, events, result: None })
    }

    /// What teams at every building are worth; none for closed ones.
    fn values(&mut self) -> Result<Vec<Option<TeamValues>>, StageError> {
        let open = self.stage.world.with(|cities| cities.open_tasks(0));
        let mut values = Vec::new();
        for task in 0..self.buildings.len() {
            let here = self.stage.allocation().iter().take(self.agents.len()).enumerate();
            let here = here.filter(|(_, own)| usize::from(**own) == task);
            let chosen = here.fold(0, |team, (agent, _)| team | 1_u64 << agent);
            let teams = candidates(self.agents.len(), self.team_max, chosen);
            let known = match open >> task & 1 {
                1 => self.stage.team_values(task, &teams)?,
                _ => None,
            };
            values.push(known.map(|known| TeamValues::of(&teams, &known, chosen)));
        }
        Ok(values)
    }
}
