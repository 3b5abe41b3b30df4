//! World, runners and allocator of a deployed team in one thread, a step at a time.

use alloc::boxed::Box;
use alloc::vec::Vec;
use alloc::{format, vec};

use sortie_attention::AttentionProbe;
use sortie_core::allocate::{TaskRelation, TeamQuery, TeamValueNetwork};
use sortie_core::link::{Direct, DirectCursor, FrameRx};
use sortie_core::roles::{
    AllocatorOptions, AllocatorRole, Identity, Poll, RunnerOptions, RunnerRole, TickReport,
    WorldObserver, WorldOptions, WorldRole,
};
use sortie_core::wire::{FrameFormat, FrameView};
use sortie_core::{Policy, World};

use crate::cast::Cast;
use crate::error::StageError;
use crate::memory::{AllocatorMemory, Memory, StageClock};
use crate::mind::{Allocators, Decisions, Learned, Note, NotingPolicy, Remembered};

/// How long a world waits for an agent that does not answer: only the order of events counts here.
const PATIENCE_NS: u64 = 1_000_000;
/// An agent for which nobody acts in so many ticks is absent, as for worlds that are processes.
const ABSENT_AFTER: u32 = 3;

/// What became of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// An episode begins: its first state has been decided on.
    Begun,
    /// A step was taken, and the state after it has been decided on.
    Stepped,
    /// A step was taken, and the episode is over.
    Over,
}

/// A team that plays in a world, each agent with a runner of its own.
pub struct Stage<'a, W> {
    /// What it plays in.
    pub world: W,
    format: FrameFormat,
    clock: &'a StageClock,
    messages: Direct<'a>,
    world_role: Box<WorldRole>,
    world_cursor: DirectCursor,
    allocator_role: Box<AllocatorRole>,
    allocator_cursor: DirectCursor,
    runner: RunnerOptions,
    runners: Vec<Option<Runner>>,
    /// Processes that there have been.
    processes: u32,
    /// Reads what the team sees.
    onlooker: DirectCursor,
    decisions: Decisions<'a>,
    /// None where agents are not assigned to subtasks.
    allocators: Option<Allocators<'a>>,
}

/// The process of one agent.
struct Runner {
    role: Box<RunnerRole>,
    cursor: DirectCursor,
    memory: Remembered,
}

/// What a world told while it was polled.
#[derive(Default)]
struct Watch {
    stepped: bool,
    is_over: bool,
}

impl WorldObserver for Watch {
    fn tick(&mut self, report: &TickReport<'_>) {
        self.stepped = true;
        self.is_over = report.outcome.episode_ended;
    }
}

impl<'a, W: World> Stage<'a, W> {
    /// A team before its first episode. `seed` matters to rules of allocation that draw.
    ///
    /// # Errors
    /// A plan is another network's.
    pub fn new(
        memory: &'a mut Memory,
        cast: &Cast,
        world: W,
        seed: u64,
    ) -> Result<Self, StageError> {
        Self::without(0, memory, cast, world, seed)
    }

    /// The same with agents that are absent until they are [revived](Self::revive): bit a for agent a.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn without(
        absent: u64,
        memory: &'a mut Memory,
        cast: &Cast,
        world: W,
        seed: u64,
    ) -> Result<Self, StageError> {
        let Memory { agents: team, allocator: allocating, frames, format, clock, entry } = memory;
        let clock: &'a StageClock = clock;
        let format = *format;
        let agents = format.layout.shape().agents;
        let (assigns, probe) = (allocating.is_some(), cast.attention.clone());
        let probe = probe.map(|layers| AttentionProbe::new(layers, format.layout.shape().features));
        let mind = team.mind(cast)?;
        let learned = allocating.as_mut().map(AllocatorMemory::bind).transpose()?;
        let allocators = learned.map(|learned| Allocators::new(learned, entry, agents, seed));
        let allocator = AllocatorOptions {
            format,
            identity: Identity::new(1, "allocator"),
            decision_interval: cast.decision_interval,
        };
        let runner = RunnerOptions {
            format,
            identity: Identity::new(1, "runner"),
            agents: 0,
            subtasks: assigns,
            decision_interval: cast.decision_interval,
            period_ns: 0,
            safe_action: cast.safe_action,
        };
        let mut stage = Self {
            world,
            format,
            clock,
            messages: Direct::new(frames, clock),
            world_role: Box::new(WorldRole::new(WorldOptions {
                absent,
                ..world_options(cast, format, assigns)
            })),
            world_cursor: DirectCursor::default(),
            allocator_role: Box::new(AllocatorRole::new(allocator)),
            allocator_cursor: DirectCursor::default(),
            runner,
            runners: (0..agents).map(|_| None).collect(),
            processes: 1,
            onlooker: DirectCursor::default(),
            decisions: Decisions { mind, are_told: false, probe, notes: Vec::new() },
            allocators,
        };
        if assigns {
            stage.allocator_role.lead(1);
            stage
                .allocator_role
                .join(&mut stage.messages.allocator(&mut stage.allocator_cursor))?;
        }
        for agent in (0..agents).filter(|agent| absent >> agent & 1 == 0) {
            stage.revive(agent)?;
            // There is room for a few statuses at a time.
            stage.poll_world(&mut Watch::default())?;
        }
        Ok(stage)
    }

    /// Notes from now on what agents think, which takes longer than their decisions.
    pub fn attend(&mut self) {
        self.decisions.are_told = true;
    }

    /// Takes the step that has been decided on, if there is one, and decides on the next.
    ///
    /// # Errors
    /// A role ended, which takes a broken plan or world.
    pub fn go_on(&mut self) -> Result<Moment, StageError> {
        let mut watch = Watch::default();
        loop {
            let polled = self.poll_world(&mut watch)?;
            if watch.is_over {
                self.forget();
                return Ok(Moment::Over);
            }
            if self.sees_new_frame()? {
                break;
            }
            match polled {
                Poll::Wait { until_ns: u64::MAX } => return Err(StageError::Stalled),
                Poll::Wait { until_ns } => self.clock.advance_to(until_ns),
                Poll::Ended => return Err(StageError::Stalled),
                Poll::Again | Poll::Answered => {}
            }
        }
        for Runner { memory, .. } in self.runners.iter_mut().flatten() {
            memory.before.copy_from_slice(&memory.now);
        }
        self.decide()?;
        Ok(if watch.stepped { Moment::Stepped } else { Moment::Begun })
    }

    /// The world has been changed: everybody sees and decides anew, the allocator first.
    ///
    /// # Errors
    /// As [`Self::go_on`].
    pub fn look_again(&mut self) -> Result<(), StageError> {
        for Runner { memory, .. } in self.runners.iter_mut().flatten() {
            memory.now.copy_from_slice(&memory.before);
        }
        self.world_role.observe_anew();
        self.go_on().map(drop)
    }

    /// Ends the process of an agent, which says no goodbye.
    pub fn kill(&mut self, agent: usize) {
        if let Some(runner) = self.runners.get_mut(agent) {
            *runner = None;
        }
    }

    /// Starts a process for an agent, in place of the one that it has.
    ///
    /// # Errors
    /// Its seat cannot be taken.
    pub fn revive(&mut self, agent: usize) -> Result<(), StageError> {
        self.processes += 1;
        let identity = Identity::new(self.processes, &format!("runner/{agent}"));
        let options = RunnerOptions { identity, agents: 1 << agent, ..self.runner };
        let mut runner = Runner {
            role: Box::new(RunnerRole::new(options)),
            cursor: DirectCursor::default(),
            memory: Remembered::nothing(self.decisions.mind.hidden()),
        };
        runner.role.join(&mut self.messages.agent(&mut runner.cursor))?;
        if let Some(seat) = self.runners.get_mut(agent) {
            *seat = Some(runner);
        }
        Ok(())
    }

    /// Whether a process acts for an agent.
    pub fn lives(&self, agent: usize) -> bool {
        self.runners.get(agent).is_some_and(Option::is_some)
    }

    /// Whether an agent is left out of allocations, since nobody has acted for it for some ticks.
    pub fn is_absent(&self, agent: usize) -> bool {
        self.world_role.absent() >> agent & 1 == 1
    }

    /// Has somebody else allocate from the next decision on: 0 what was learned, 1 and up the environment's rules.
    pub fn choose_allocator(&mut self, choice: usize) {
        if let Some(allocators) = &mut self.allocators {
            allocators.chosen = choice;
        }
    }

    /// Agents that there may be.
    pub fn slots(&self) -> usize {
        self.runners.len()
    }

    /// `[A]`: the allocation in force; empty where agents are not assigned.
    pub fn allocation(&self) -> &[u8] {
        self.allocators.as_ref().map_or(&[], |allocators| &allocators.newest)
    }

    /// Whether the allocator was asked in the current state.
    pub fn is_allocated_anew(&self) -> bool {
        self.allocators.as_ref().is_some_and(|allocators| allocators.decided)
    }

    /// Largest team of one subtask that is valued; 0 where teams are not.
    pub fn team_max(&self) -> usize {
        match self.allocators.as_ref().map(|allocators| &allocators.learned) {
            Some(Learned::TeamValue(learned)) => learned.team_max,
            _ => 0,
        }
    }

    /// The decisions in the current state, in the order of the agents.
    pub(crate) fn notes(&self) -> &[Note] {
        &self.decisions.notes
    }

    /// Computes an agent's utilities once more, for whoever takes the time. False where it does not decide.
    ///
    /// # Errors
    /// The plan refuses what it has taken before.
    pub fn repeat_decision(&mut self, agent: usize) -> Result<bool, StageError> {
        let note = self.decisions.notes.iter().find(|note| note.agent == agent);
        let (Some(Note { visible, .. }), Some(Some(runner))) = (note, self.runners.get_mut(agent))
        else {
            return Ok(false);
        };
        let visible = *visible;
        let end = self.messages.agent(&mut self.onlooker);
        let Some(view) = view(&end, &self.format) else { return Ok(false) };
        let mut utilities = [0.0; sortie_core::limits::ACTIONS];
        let mut policy =
            NotingPolicy { decisions: &mut self.decisions, memory: &mut runner.memory };
        let utilities = &mut utilities[..policy.actions()];
        policy.utilities(&view.observation(agent, &visible), utilities)?;
        Ok(true)
    }

    /// What the network expects of teams, bit a for agent a, at a subtask that is open; none where there is no frame, or
    /// nobody values teams.
    ///
    /// # Errors
    /// The network refuses the state.
    pub fn team_values(
        &mut self,
        task: usize,
        teams: &[u64],
    ) -> Result<Option<Vec<f32>>, StageError> {
        let end = self.messages.agent(&mut self.onlooker);
        let Some(view) = view(&end, &self.format) else { return Ok(None) };
        let state = view.allocation_state();
        let Some(Allocators { learned: Learned::TeamValue(learned), .. }) = &mut self.allocators
        else {
            return Ok(None);
        };
        let mut relation = vec![0.0; state.entity_task.len() * learned.relation.columns()];
        learned.relation.observe(&state)?;
        learned.relation.write(&state, task, &mut relation);
        let query = TeamQuery { state: &state, task, team: 0, relation: &relation };
        let mut values = vec![0.0; teams.len()];
        learned.network.values(&query, teams, &mut values)?;
        Ok(Some(values))
    }

    fn poll_world(&mut self, watch: &mut Watch) -> Result<Poll, StageError> {
        let mut link = self.messages.world(&mut self.world_cursor);
        Ok(self.world_role.poll(&mut link, &mut self.world, watch)?)
    }

    /// Whether a frame has come that asks for actions.
    fn sees_new_frame(&mut self) -> Result<bool, StageError> {
        let mut end = self.messages.agent(&mut self.onlooker);
        Ok(end.receive_frames(&mut |frame| frame.header.asks_for_actions())?)
    }

    /// Allocator and runners work until nobody has anything left to do.
    fn decide(&mut self) -> Result<(), StageError> {
        self.forget();
        loop {
            let mut is_moving = false;
            if let Some(allocators) = &mut self.allocators {
                let mut link = self.messages.allocator(&mut self.allocator_cursor);
                is_moving |= self.allocator_role.poll(&mut link, allocators)?.is_progress();
            }
            for Runner { role, cursor, memory } in self.runners.iter_mut().flatten() {
                let mut policy = NotingPolicy { decisions: &mut self.decisions, memory };
                let mut link = self.messages.agent(cursor);
                is_moving |= role.poll(&mut link, &mut policy)?.is_progress();
            }
            if !is_moving {
                self.decisions.notes.sort_by_key(|note| note.agent);
                return Ok(());
            }
        }
    }

    /// What was noted is of an earlier state.
    fn forget(&mut self) {
        self.decisions.notes.clear();
        if let Some(allocators) = &mut self.allocators {
            allocators.decided = false;
        }
    }
}

/// What an onlooker sees: the frame that the team decides on.
fn view<'f>(end: &'f impl FrameRx, format: &FrameFormat) -> Option<FrameView<'f>> {
    let frame = end.frame()?;
    FrameView::new(frame.header, frame.payload, format).ok()
}

fn world_options(cast: &Cast, format: FrameFormat, assigns: bool) -> WorldOptions {
    WorldOptions {
        format,
        identity: Identity::new(1, "world"),
        term: 1,
        required: format.layout.every_agent(),
        allocator: assigns,
        strict: false,
        pipelined: false,
        join_patience_ns: u64::MAX,
        period_ns: 0,
        patience_ns: PATIENCE_NS,
        absent_after: ABSENT_AFTER,
        absent: 0,
        decision_interval: cast.decision_interval,
        safe_action: cast.safe_action,
        episodes: None,
        tick_interval_ns: 0,
    }
}
