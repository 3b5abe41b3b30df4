//! A small world, policy and allocator whose every number depends on all that went before, so that
//! one different message shows in the whole log.

use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use sortie_core::roles::{TickReport, WorldObserver};
use sortie_core::wire::{AllocMsg, FrameMut};
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, EntityMask, Observation,
    Policy, Shape, StepOutcome, UNASSIGNED, UnavailableAction, World,
};
use sortie_ipc::{Domain, DomainContract};

pub(crate) const SHAPE: Shape = Shape { agents: 3, entities: 6, tasks: 2, actions: 5, features: 4 };
/// Steps of an episode.
pub(crate) const EPISODE: u32 = 25;

pub(crate) fn contract() -> DomainContract {
    let mut fields = toml::Table::new();
    fields.insert("environment".into(), "toy".into());
    DomainContract {
        hash: 0x1234_5678_9abc_def0,
        decision_interval: 4,
        subtasks: true,
        safe_action: Some(1),
        fields,
        ..DomainContract::default()
    }
}

/// A domain that no other test uses.
pub(crate) fn domain() -> Domain {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let id = format!("t{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
    Domain::new(&id).unwrap()
}

/// What is left of a domain in shared memory.
pub(crate) fn leftovers(domain: &Domain) -> Vec<String> {
    let marker = format!("-{}-", domain.id());
    let objects = std::fs::read_dir("/dev/shm").unwrap();
    let mut left: Vec<String> = objects
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .filter(|name| name.contains(&marker))
        .collect();
    if Path::new(domain.base()).exists() {
        left.push(domain.base().display().to_string());
    }
    left
}

/// A step of a linear congruential generator.
pub(crate) fn mix(state: u64, with: u64) -> u64 {
    (state ^ with).wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407)
}

/// Agent `step % 7` is absent while the step is odd; subtask 0 closes half-way.
pub(crate) struct ToyWorld {
    agents: usize,
    state: u64,
    step: u32,
    episode: u64,
}

impl ToyWorld {
    pub(crate) fn new() -> Self {
        Self::of(SHAPE.agents)
    }

    /// With another number of agents, up to eight.
    pub(crate) fn of(agents: usize) -> Self {
        Self { agents, state: 0, step: 0, episode: 0 }
    }

    fn is_present(&self, agent: usize) -> bool {
        self.step.is_multiple_of(2) || self.step as usize % 7 != agent
    }

    fn is_available(&self, agent: usize, action: usize) -> bool {
        action == 1 || !(self.state >> (8 * agent + action)).is_multiple_of(3)
    }
}

impl World for ToyWorld {
    fn shape(&self) -> Shape {
        let others = SHAPE.entities - SHAPE.agents;
        Shape { agents: self.agents, entities: self.agents + others, ..SHAPE }
    }

    fn reset(&mut self) {
        self.episode += 1;
        self.state = mix(0, self.episode);
        self.step = 0;
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        let Shape { agents, entities, .. } = self.shape();
        let mut present = EntityMask::first(entities);
        for agent in (0..agents).filter(|&agent| !self.is_present(agent)) {
            present.remove(agent);
        }
        frame.set_present(&present);
        for entity in 0..entities {
            for (column, feature) in frame.row_mut(entity).iter_mut().enumerate() {
                let bits = mix(self.state, (16 * entity + column) as u64);
                *feature = (bits >> 40) as f32 / 16_777_216.0;
            }
            if entity >= agents {
                frame.set_entity_task(entity, 1 << (entity % SHAPE.tasks));
            }
        }
        for agent in 0..agents {
            let sees = EntityMask::from_words(&[self.state >> agent | 1 << agent]);
            frame.set_observable(agent, &sees);
            for (action, code) in frame.available_mut(agent).iter_mut().enumerate() {
                *code = u16::from(self.is_available(agent, action));
            }
        }
        frame.set_open_tasks(if self.step < EPISODE / 2 { 0b11 } else { 0b10 });
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        for (agent, &action) in actions.iter().enumerate() {
            if self.is_present(agent) && !self.is_available(agent, usize::from(action)) {
                return Err(UnavailableAction { agent, action });
            }
        }
        self.state = actions.iter().fold(self.state, |state, &action| mix(state, action.into()));
        self.step += 1;
        Ok(StepOutcome {
            episode_ended: self.step == EPISODE,
            tasks_changed: self.step == EPISODE / 2,
        })
    }
}

/// Utilities are weighted sums of what is visible. Refuses where its own row sums to little.
pub(crate) struct ToyPolicy;

impl Policy for ToyPolicy {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let row = |entity: usize| {
            let first = entity * observation.stride;
            &observation.rows[first..first + SHAPE.features]
        };
        if row(observation.self_index).iter().sum::<f32>() < 0.5 {
            return Err(DecideError::NonFinite);
        }
        for (action, utility) in utilities.iter_mut().enumerate() {
            let last = observation.last_actions[observation.self_index];
            *utility = if usize::from(last) == action { 0.25 } else { 0.0 };
            for entity in observation.visible.iter() {
                let weight = (1 + entity + action) as f32;
                *utility += row(entity).iter().map(|x| (x * weight).sin()).sum::<f32>();
            }
        }
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = [0.0; SHAPE.actions];
        self.utilities(observation, &mut utilities)?;
        let available = utilities.iter().zip(observation.available).enumerate();
        let (action, utility) = available
            .filter(|(_, (_, code))| **code != 0)
            .map(|(action, (utility, _))| (action, *utility))
            .fold(None, |best, (action, utility)| match best {
                Some((_, highest)) if highest >= utility => best,
                _ => Some((action, utility)),
            })
            .ok_or(DecideError::NoAvailableAction)?;
        Ok(Decision { action: action as u16, utility })
    }
}

/// Gives every agent an open subtask, or none, by its first feature and its last subtask.
pub(crate) struct ToyAllocator;

impl Allocator for ToyAllocator {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        for (agent, task) in allocation.iter_mut().enumerate() {
            let feature = (state.rows[agent * state.stride] * 1024.0) as u32;
            let wish = (feature + state.entity_task[agent]) % 3;
            let is_open = wish < 2 && state.open_tasks >> wish & 1 == 1;
            *task = if is_open { wish as u8 } else { UNASSIGNED };
        }
        Ok(())
    }
}

/// Everything about a run that may not depend on time, process or transport.
#[derive(Default)]
pub(crate) struct DecisionLog {
    pub(crate) lines: Vec<String>,
    pub(crate) allocations: Vec<AllocMsg>,
    pub(crate) episodes: u32,
    pub(crate) tick_ns: Vec<u64>,
}

impl WorldObserver for DecisionLog {
    fn allocated(&mut self, allocation: &AllocMsg) {
        self.allocations.push(*allocation);
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        self.tick_ns.push(report.tick_ns);
        let step = (report.episode, report.step, report.tick as u32);
        self.lines.push(format!("{step:?} {:?}", report.actions));
        for answer in report.answers() {
            self.lines.push(format!(
                "  agent {} action {} q {:08x} task {} term {} epoch {}",
                answer.agent,
                answer.action,
                answer.q.to_bits(),
                answer.task,
                answer.alloc_term,
                answer.alloc_epoch,
            ));
        }
        if let Some(allocation) = report.allocation {
            self.lines.push(format!("  {:?}", &allocation.task[..SHAPE.agents]));
        }
    }

    fn episode_ended(&mut self, episode: u32, steps: u32) {
        self.lines.push(format!("episode {episode} ended after {steps}"));
        self.episodes += 1;
    }
}

/// Compares two runs line by line, and names the first that differs.
pub(crate) fn assert_same_log(one: &DecisionLog, other: &DecisionLog) {
    for (index, (one, other)) in one.lines.iter().zip(&other.lines).enumerate() {
        assert_eq!(one, other, "line {index}");
    }
    assert_eq!(one.lines.len(), other.lines.len());
}

/// Ends a test that hangs: the whole test process, since its threads cannot be ended.
pub(crate) struct Watchdog {
    _until_dropped: mpsc::Sender<()>,
}

impl Watchdog {
    pub(crate) fn new() -> Self {
        let (until_dropped, waits) = mpsc::channel::<()>();
        let name = std::thread::current().name().unwrap_or_default().to_string();
        std::thread::spawn(move || {
            if waits.recv_timeout(Duration::from_secs(60)) == Err(RecvTimeoutError::Timeout) {
                eprintln!("watchdog: {name} hangs");
                std::process::exit(1);
            }
        });
        Self { _until_dropped: until_dropped }
    }
}
