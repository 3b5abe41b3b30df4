//! The roles of a team, fed by its record.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;

use serde::Serialize;
use sortie_bundle::{Bundle, SubtaskConditioning};
use sortie_core::roles::{AllocatorOptions, AllocatorRole, Identity, RunnerOptions, RunnerRole};
use sortie_core::wire::{ActionMsg, AllocMsg};
use sortie_core::{Allocator, Policy, UNASSIGNED};

use super::contents::{Contents, Shown, Told};
use super::playback::Playback;
use crate::deployment::model_id;
use crate::worlds::RuleAllocator;

/// Frames and allocations that are kept for answers to come: a runner answers the newest frame or the one before.
const KEPT: usize = 8;
/// What of an answer is the same whenever it is given.
const DECIDED: u16 =
    ActionMsg::STALE_ALLOC | ActionMsg::NO_ALLOC | ActionMsg::FALLBACK | ActionMsg::STATE_RESET;

/// Who decides again.
pub(super) struct Team<'a> {
    /// One for each runner, in the order of their numbers.
    pub(super) policies: Vec<Box<dyn Policy + 'a>>,
    pub(super) fallback: Option<&'a mut RuleAllocator>,
    pub(super) allocator: Option<Box<dyn Allocator + 'a>>,
}

/// What was made again, and what was not.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Made {
    pub(super) actions: u64,
    pub(super) allocations: u64,
    pub(super) different: u64,
    pub(super) before_record: u64,
    pub(super) of_others: u64,
    pub(super) of_engines: u64,
    pub(super) without_memory: u64,
}

/// A decision that came out otherwise.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Difference {
    pub(super) tick: u32,
    pub(super) episode: u32,
    /// None of an allocation.
    pub(super) agent: Option<u16>,
    pub(super) what: &'static str,
    pub(super) recorded: String,
    pub(super) made: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tick, episode, agent, what, recorded, made } = self;
        write!(f, "tick {tick}, episode {episode}")?;
        if let Some(agent) = agent {
            write!(f, ", agent {agent}")?;
        }
        write!(f, ": {what} is {recorded} in the record, and {made} made again")
    }
}

/// A runner that decides again.
struct Runner<'a> {
    role: RunnerRole,
    policy: Box<dyn Policy + 'a>,
    /// Its agents remember something.
    remembers: bool,
    /// What they remember is what they remembered then, as far as they do; unknown until that was emptied.
    knows: bool,
    is_engine: bool,
    /// Its answers to one frame, until all of them are there.
    waiting: Vec<ActionMsg>,
}

impl Runner<'_> {
    /// Decides what it answered to a frame; none where it does not know what it remembered.
    fn decide(
        &mut self,
        mut link: Playback<'_>,
        answers: &[ActionMsg],
        fallback: Option<&mut RuleAllocator>,
    ) -> Option<Vec<ActionMsg>> {
        let Self { role, policy, knows, .. } = self;
        role.act_for(answers.iter().fold(0, |set, answer| set | 1 << (answer.agent & 63)));
        // A reload empties what agents remember in the midst of an episode.
        let emptied = answers.iter().find(|answer| answer.has(ActionMsg::STATE_RESET));
        if let Some(answer) = emptied {
            role.change_model(model_of(answer));
        }
        let polled = match fallback {
            Some(rule) => role.poll_with_heuristic(&mut link, policy, rule),
            None => role.poll(&mut link, policy),
        };
        debug_assert!(polled.is_ok(), "a link that cannot fail");
        let empties = link.actions.iter().any(|action| action.has(ActionMsg::STATE_RESET));
        *knows = emptied.is_some() || (*knows && !empties);
        knows.then_some(link.actions)
    }
}

/// All roles, and what they are fed with.
pub(super) struct Roles<'a> {
    runners: BTreeMap<u32, Runner<'a>>,
    fallback: Option<&'a mut RuleAllocator>,
    allocator: Option<(AllocatorRole, Box<dyn Allocator + 'a>)>,
    model: u32,
    frames: VecDeque<Shown>,
    allocations: VecDeque<AllocMsg>,
    made: Made,
    first_difference: Option<Difference>,
}

impl<'a> Roles<'a> {
    pub(super) fn new(contents: &Contents, bundle: &Bundle, team: Team<'a>) -> Self {
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
        let runner = |(pid, mut policy): (&u32, Box<dyn Policy + 'a>)| {
            let is_engine = contents.engines.contains(pid);
            let (role, remembers) = (RunnerRole::new(options), policy.begin_episode());
            let (knows, waiting) = (!remembers, Vec::new());
            (*pid, Runner { role, policy, remembers, knows, is_engine, waiting })
        };
        let [a, b, c, d, ..] = model_id(bundle);
        let options = AllocatorOptions { format, identity, decision_interval };
        Self {
            runners: contents.runners.iter().zip(team.policies).map(runner).collect(),
            fallback: team.fallback,
            allocator: team.allocator.map(|it| (AllocatorRole::new(options), it)),
            model: u32::from_le_bytes([a, b, c, d]),
            frames: VecDeque::new(),
            allocations: VecDeque::new(),
            made: Made::default(),
            first_difference: None,
        }
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
                let Some(runner) = self.runners.get_mut(&message.runner) else { return };
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

    /// What was made, and the first that came out otherwise.
    pub(super) fn end(mut self) -> (Made, Option<Difference>) {
        let runners: Vec<u32> = self.runners.keys().copied().collect();
        runners.into_iter().for_each(|runner| self.answer(runner));
        (self.made, self.first_difference)
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
        if first.model != self.model {
            self.made.of_others += count;
            return;
        }
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
            runner.knows = !runner.remembers;
            return;
        };
        let link = Playback::new(frame, allocation);
        let Some(made) = runner.decide(link, &answers, self.fallback.as_deref_mut()) else {
            self.made.without_memory += count;
            return;
        };
        self.made.actions += count;
        for recorded in &answers {
            let made = made.iter().find(|made| made.agent == recorded.agent);
            if let Some(difference) = different(recorded, made, frame.header.episode) {
                self.made.different += 1;
                self.first_difference.get_or_insert(difference);
            }
        }
    }

    /// Has the allocator allocate again what it allocated.
    fn allocate(&mut self, recorded: &AllocMsg) {
        if recorded.model != self.model {
            self.made.of_others += 1;
            return;
        }
        let frame = self.frames.iter().find(|frame| frame.header.tick == recorded.tick);
        let (Some(frame), Some((role, allocator))) = (frame, &mut self.allocator) else {
            self.made.before_record += 1;
            return;
        };
        // Who begins to lead answers the newest frame, whether or not it asks.
        role.lead(recorded.term);
        let mut link = Playback::new(frame, None);
        let polled = role.poll(&mut link, allocator.as_mut());
        self.made.allocations += 1;
        let made = link.allocations.first();
        let agents = usize::from(recorded.n_agents);
        let tasks = |message: &AllocMsg| -> Vec<Option<u8>> {
            let tasks = message.task.iter().take(agents);
            tasks.map(|task| Some(*task).filter(|task| *task != UNASSIGNED)).collect()
        };
        if made.is_none_or(|made| tasks(made) != tasks(recorded)) {
            self.made.different += 1;
            self.first_difference.get_or_insert_with(|| Difference {
                tick: recorded.tick as u32,
                episode: frame.header.episode,
                agent: None,
                what: "the allocation",
                recorded: format!("{:?}", tasks(recorded)),
                made: match (made, polled) {
                    (Some(made), _) => format!("{:?}", tasks(made)),
                    (None, Err(error)) => format!("refused: {error}"),
                    (None, Ok(_)) => "none".to_owned(),
                },
            });
        }
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

/// What is decided of an answer: its name, its bits, and how it is told.
type Field = (&'static str, fn(&ActionMsg) -> u64, fn(&ActionMsg) -> String);
const FIELDS: [Field; 5] = [
    ("the action", |it| it.action.into(), |it| it.action.to_string()),
    ("the subtask", |it| it.task.into(), |it| it.task.to_string()),
    ("the utility", |it| it.q.to_bits().into(), |it| format!("{} ({:08x})", it.q, it.q.to_bits())),
    (
        "the allocation acted on",
        |it| u64::from(it.alloc_term) << 32 | u64::from(it.alloc_epoch),
        |it| format!("{} of term {}", it.alloc_epoch, it.alloc_term),
    ),
    (
        "the set of flags",
        |it| (it.flags & DECIDED).into(),
        |it| format!("{:#x}", it.flags & DECIDED),
    ),
];

/// In what two answers differ, if they do.
fn different(recorded: &ActionMsg, made: Option<&ActionMsg>, episode: u32) -> Option<Difference> {
    let (tick, agent) = (recorded.tick as u32, Some(recorded.agent));
    let Some(made) = made else {
        let (recorded, made) = ("there".to_owned(), "missing".to_owned());
        return Some(Difference { tick, episode, agent, what: "the answer", recorded, made });
    };
    let (what, _, told) = FIELDS.iter().find(|(_, bits, _)| bits(recorded) != bits(made))?;
    let (recorded, made) = (told(recorded), told(made));
    Some(Difference { tick, episode, agent, what, recorded, made })
}
