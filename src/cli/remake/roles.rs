//! The roles of a team, fed by its record.

use std::collections::{BTreeMap, VecDeque};

use serde::Serialize;
use sortie_bundle::{Bundle, SubtaskConditioning};
use sortie_core::roles::{AllocatorOptions, AllocatorRole, Identity, RunnerOptions, RunnerRole};
use sortie_core::wire::{ActionMsg, AllocMsg};
use sortie_core::{Allocator, Policy};

use super::contents::{Contents, Shown, Told};
use super::playback::Playback;
use crate::deployment::model_id;
use crate::failure::Failure;
use crate::run::process::fallback;
use crate::worlds::RuleAllocator;

/// Frames and allocations that are kept for answers to come: a runner answers the newest frame or the one before.
const KEPT: usize = 8;

/// Who decides again by one bundle: a team may have changed its own.
pub(super) struct Team<'a> {
    /// Whose decisions are made again, as far as messages name a model; none: everybody's.
    pub(super) model: Option<u32>,
    /// One for each runner, in the order of their numbers.
    pub(super) policies: Vec<Box<dyn Policy + 'a>>,
    pub(super) allocator: Option<Box<dyn Allocator + 'a>>,
}

impl Team<'_> {
    fn takes(&self, model: u32) -> bool {
        self.model.is_none_or(|own| own == model)
    }
}

/// What was made again, and what was not.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Made {
    pub(super) actions: u64,
    pub(super) allocations: u64,
    pub(super) before_record: u64,
    pub(super) of_others: u64,
    pub(super) of_engines: u64,
    pub(super) without_memory: u64,
}

/// Who judges what is decided again.
pub(super) trait Judge {
    /// An answer, and what came of it; `None`: nothing did.
    fn action(&mut self, recorded: &ActionMsg, made: Option<&ActionMsg>, frame: &Shown);

    /// An allocation, and what came of it, or why nothing did.
    fn allocation(&mut self, recorded: &AllocMsg, made: Result<&AllocMsg, String>, frame: &Shown);
}

/// A runner that decides again.
struct Runner {
    role: RunnerRole,
    /// Its place among the policies of every team.
    place: usize,
    /// What decided its last answers, as far as they name it.
    model: u32,
    /// What its agents remember is what they remembered then; unknown until that was emptied.
    knows: bool,
    is_engine: bool,
    /// Its answers to one frame, until all of them are there.
    waiting: Vec<ActionMsg>,
}

impl Runner {
    /// Decides what it answered to a frame; none where it does not know what it remembered.
    fn decide(
        &mut self,
        mut link: Playback<'_>,
        (first, answers): (&ActionMsg, &[ActionMsg]),
        policy: &mut dyn Policy,
        fallback: Option<&mut RuleAllocator>,
    ) -> Option<Vec<ActionMsg>> {
        let Self { role, model, knows, .. } = self;
        role.act_for(answers.iter().fold(0, |set, answer| set | 1 << (answer.agent & 63)));
        // A change of the bundle empties what agents remember in the midst of an episode; so does the same one loaded anew.
        let is_emptied = answers.iter().any(|answer| answer.has(ActionMsg::STATE_RESET));
        let is_another = std::mem::replace(model, first.model) != first.model;
        if is_emptied || is_another {
            role.change_model(model_of(first));
        }
        let polled = match fallback {
            Some(rule) => role.poll_with_heuristic(&mut link, policy, rule),
            None => role.poll(&mut link, policy),
        };
        debug_assert!(polled.is_ok(), "a link that cannot fail");
        // Agents without a memory never say that it was emptied.
        let empties = link.actions.iter().any(|action| action.has(ActionMsg::STATE_RESET));
        *knows = is_emptied || (*knows || is_another) && !empties;
        knows.then_some(link.actions)
    }
}

/// All roles, and what they are fed with.
pub(super) struct Roles<'a> {
    runners: BTreeMap<u32, Runner>,
    allocator: AllocatorRole,
    teams: Vec<Team<'a>>,
    fallback: Option<RuleAllocator>,
    judge: &'a mut dyn Judge,
    frames: VecDeque<Shown>,
    allocations: VecDeque<AllocMsg>,
    made: Made,
}

impl<'a> Roles<'a> {
    /// The roles of a record; `bundle` is any of those that decide again, for they have one contract.
    pub(super) fn new(
        contents: &Contents,
        bundle: &Bundle,
        teams: Vec<Team<'a>>,
        judge: &'a mut dyn Judge,
    ) -> Result<Self, Failure> {
        let (contract, facts) = (bundle.contract(), &contents.facts);
        let format = contents.format;
        let identity = Identity { model: model_id(bundle), ..Identity::new(0, "remake") };
        let decision_interval = contract.decision_interval;
        let options = RunnerOptions {
            format,
            identity,
            agents: 0,
            subtasks: contract.subtask_conditioning == SubtaskConditioning::Mask,
            decision_interval,
            period_ns: facts.period_ns(),
            safe_action: contract.safe_action,
        };
        let runner = |(place, pid): (usize, &u32)| {
            let is_engine = contents.engines.contains(pid);
            let (role, waiting) = (RunnerRole::new(options), Vec::new());
            (*pid, Runner { role, place, model: 0, knows: false, is_engine, waiting })
        };
        let options = AllocatorOptions { format, identity, decision_interval };
        Ok(Self {
            runners: contents.runners.iter().enumerate().map(runner).collect(),
            allocator: AllocatorRole::new(options),
            teams,
            fallback: fallback(bundle)?,
            judge,
            frames: VecDeque::new(),
            allocations: VecDeque::new(),
            made: Made::default(),
        })
    }

    /// Takes in what the record tells next.
    pub(super) fn hear(&mut self, told: Told) {
        match told {
            Told::Frame(shown) => {
                keep(&mut self.frames, shown);
            }
            Told::Allocation(message) => {
                self.allocate(&message);
                keep(&mut self.allocations, message);
            }
            Told::Action(message) => {
                if message.has(ActionMsg::BYE) {
                    return;
                }
                let Some(runner) = self.runners.get(&message.runner) else { return };
                let is_next =
                    runner.waiting.first().is_some_and(|first| first.tick != message.tick);
                if is_next {
                    self.answer(message.runner);
                }
                if let Some(runner) = self.runners.get_mut(&message.runner) {
                    runner.waiting.push(message);
                }
            }
        }
    }

    /// Has all runners answer what waits. Returns what was made.
    pub(super) fn end(mut self) -> Made {
        let runners: Vec<u32> = self.runners.keys().copied().collect();
        runners.into_iter().for_each(|runner| self.answer(runner));
        self.made
    }

    /// A frame that was shown a few ticks ago.
    pub(super) fn frame(&self, tick: u64) -> Option<&Shown> {
        self.frames.iter().find(|frame| frame.header.tick == tick)
    }

    /// What was made so far, and what was not.
    pub(super) fn made(&self) -> Made {
        self.made
    }

    /// Has a runner answer again what it answered last.
    pub(super) fn answer(&mut self, runner: u32) {
        let Some(runner) = self.runners.get_mut(&runner) else { return };
        let answers = std::mem::take(&mut runner.waiting);
        let Some(first) = answers.first() else { return };
        let count = answers.len() as u64;
        let team = self.teams.iter_mut().find(|team| team.takes(first.model));
        let Some(policy) = team.and_then(|team| team.policies.get_mut(runner.place)) else {
            self.made.of_others += count;
            return;
        };
        if runner.is_engine {
            self.made.of_engines += count;
            return;
        }
        let order = (first.alloc_term, first.alloc_epoch);
        let allocation = self.allocations.iter().rfind(|it| it.order() == order);
        let found = self.frames.iter().find(|frame| frame.header.tick == first.tick);
        let frame = found.filter(|_| order == (0, 0) || allocation.is_some());
        let Some(frame) = frame else {
            self.made.before_record += count;
            // What agents remember has gone on without this.
            runner.knows = !policy.begin_episode();
            return;
        };
        let link = Playback::new(frame, allocation);
        let fallback = self.fallback.as_mut();
        let made = runner.decide(link, (first, &answers), policy.as_mut(), fallback);
        let Some(made) = made else {
            self.made.without_memory += count;
            return;
        };
        self.made.actions += count;
        for recorded in &answers {
            let made = made.iter().find(|made| made.agent == recorded.agent);
            self.judge.action(recorded, made, frame);
        }
    }

    /// Has the allocator allocate again what it allocated.
    fn allocate(&mut self, recorded: &AllocMsg) {
        let Some(team) = self.teams.iter_mut().find(|team| team.takes(recorded.model)) else {
            self.made.of_others += 1;
            return;
        };
        let frame = self.frames.iter().find(|frame| frame.header.tick == recorded.tick);
        let (Some(frame), Some(allocator)) = (frame, &mut team.allocator) else {
            self.made.before_record += 1;
            return;
        };
        // Who begins to lead answers the newest frame, whether or not it asks.
        self.allocator.lead(recorded.term);
        let mut link = Playback::new(frame, None);
        let polled = self.allocator.poll(&mut link, allocator.as_mut());
        self.made.allocations += 1;
        let made = link.allocations.first().ok_or_else(|| match polled {
            Err(error) => format!("refused: {error}"),
            Ok(_) => "none".to_owned(),
        });
        self.judge.allocation(recorded, made, frame);
    }
}

/// Keeps the newest.
fn keep<T>(kept: &mut VecDeque<T>, newest: T) {
    if kept.len() == KEPT {
        kept.pop_front();
    }
    kept.push_back(newest);
}

/// The model of an answer, as far as it tells.
fn model_of(answer: &ActionMsg) -> [u8; 16] {
    let mut model = [0; 16];
    model[..4].copy_from_slice(&answer.model.to_le_bytes());
    model
}
