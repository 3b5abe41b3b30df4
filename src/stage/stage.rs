//! World, runners and allocator of a deployed team in one thread, a step at a time.

use alloc::boxed::Box;
use alloc::format;
use alloc::vec;
use alloc::vec::Vec;

use sortie_attention::AttentionProbe;
use sortie_core::allocate::{TaskRelation, TeamQuery, TeamValueNetwork};
use sortie_core::link::{Direct, DirectCursor, FrameRx};
use sortie_core::plan::Plan;
use sortie_core::roles::{
    AllocatorOptions, AllocatorRole, Identity, Poll, RunnerOptions, RunnerRole, TickReport,
    WorldObserver, WorldOptions, WorldRole,
};
use sortie_core::wire::{FrameFormat, FrameView};
use sortie_core::{PlanPolicy, Policy, World};

use crate::cast::Cast;
use crate::error::StageError;
use crate::memory::{Memory, StageClock};
use crate::notes::{Allocators, Note, NotingPolicy};

/// How long a world waits for an agent that does not answer: only the order of events counts here.
const PATIENCE_NS: u64 = 1_000_000;
/// A seat that leaves so many ticks unanswered is vacant, as for worlds that are processes.
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
    policy: NotingPolicy<'a>,
    allocators: Allocators<'a>,
}

/// The process of one agent.
struct Runner {
    role: Box<RunnerRole>,
    cursor: DirectCursor,
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
        let Memory { agent, arena, values, search, frames, format, clock, entry } = memory;
        let clock: &'a StageClock = clock;
        let format = *format;
        let agents = format.layout.shape().agents;
        let policy = PlanPolicy::new(Plan::load(agent.as_slice())?, arena.as_mut_slice())?;
        let allocator = AllocatorOptions {
            format,
            identity: Identity::new(1, "allocator"),
            decision_interval: cast.decision_interval,
        };
        let runner = RunnerOptions {
            format,
            identity: Identity::new(1, "runner"),
            agents: 0,
            subtasks: true,
            decision_interval: cast.decision_interval,
            period_ns: 0,
            safe_action: cast.safe_action,
        };
        let mut stage = Self {
            world,
            format,
            clock,
            messages: Direct::new(frames, clock),
            world_role: Box::new(WorldRole::new(world_options(cast, format))),
            world_cursor: DirectCursor::default(),
            allocator_role: Box::new(AllocatorRole::new(allocator)),
            allocator_cursor: DirectCursor::default(),
            runner,
            runners: (0..agents).map(|_| None).collect(),
            processes: 1,
            onlooker: DirectCursor::default(),
            policy: NotingPolicy { policy, probe: None, notes: Vec::new() },
            allocators: Allocators::new(search.allocator(values.bind()?), entry, agents, seed),
        };
        stage.allocator_role.lead(1);
        stage.allocator_role.join(&mut stage.messages.allocator(&mut stage.allocator_cursor))?;
        for agent in 0..agents {
            stage.revive(agent)?;
            // There is room for a few statuses at a time.
            stage.poll_world(&mut Watch::default())?;
        }
        Ok(stage)
    }

    /// Notes from now on whom agents attend to, which takes longer than their decisions.
    pub fn attend(&mut self, probe: AttentionProbe) {
        self.policy.probe = Some(probe);
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
        self.decide()?;
        Ok(if watch.stepped { Moment::Stepped } else { Moment::Begun })
    }

    /// The world has been changed: everybody sees and decides anew, the allocator first.
    ///
    /// # Errors
    /// As [`Self::go_on`].
    pub fn look_again(&mut self) -> Result<(), StageError> {
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
        let mut runner =
            Runner { role: Box::new(RunnerRole::new(options)), cursor: DirectCursor::default() };
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

    /// Has somebody else allocate from the next decision on: 0 what was learned, 1 and up the environment's rules.
    pub fn choose_allocator(&mut self, choice: usize) {
        self.allocators.chosen = choice;
    }

    /// `[A]`: the allocation in force.
    pub fn allocation(&self) -> &[u8] {
        &self.allocators.newest
    }

    /// Whether the allocator was asked in the current state.
    pub fn is_allocated_anew(&self) -> bool {
        self.allocators.decided
    }

    /// The decisions in the current state, in the order of the agents.
    pub(crate) fn notes(&self) -> &[Note] {
        &self.policy.notes
    }

    /// Computes an agent's utilities once more, for whoever takes the time. False where it does not decide.
    ///
    /// # Errors
    /// The plan refuses what it has taken before.
    pub fn repeat_decision(&mut self, agent: usize) -> Result<bool, StageError> {
        let note = self.policy.notes.iter().find(|note| note.agent == agent);
        let Some(visible) = note.map(|note| note.visible) else { return Ok(false) };
        let end = self.messages.agent(&mut self.onlooker);
        let Some(view) = view(&end, &self.format) else { return Ok(false) };
        let mut utilities = [0.0; sortie_core::limits::ACTIONS];
        let utilities = &mut utilities[..self.policy.policy.actions()];
        self.policy.policy.utilities(&view.observation(agent, &visible), utilities)?;
        Ok(true)
    }

    /// What the network expects of teams, bit a for agent a, at a subtask that is open; none where there is no frame.
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
        let learned = &mut self.allocators.learned;
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
            let mut link = self.messages.allocator(&mut self.allocator_cursor);
            let polled = self.allocator_role.poll(&mut link, &mut self.allocators)?;
            let mut is_moving = polled.is_progress();
            for runner in self.runners.iter_mut().flatten() {
                let mut link = self.messages.agent(&mut runner.cursor);
                is_moving |= runner.role.poll(&mut link, &mut self.policy)?.is_progress();
            }
            if !is_moving {
                self.policy.notes.sort_by_key(|note| note.agent);
                return Ok(());
            }
        }
    }

    /// What was noted is of an earlier state.
    fn forget(&mut self) {
        self.policy.notes.clear();
        self.allocators.decided = false;
    }
}

/// What an onlooker sees: the frame that the team decides on.
fn view<'f>(end: &'f impl FrameRx, format: &FrameFormat) -> Option<FrameView<'f>> {
    let frame = end.frame()?;
    FrameView::new(frame.header, frame.payload, format).ok()
}

fn world_options(cast: &Cast, format: FrameFormat) -> WorldOptions {
    WorldOptions {
        format,
        identity: Identity::new(1, "world"),
        term: 1,
        required: format.layout.every_agent(),
        allocator: true,
        strict: false,
        pipelined: false,
        join_patience_ns: u64::MAX,
        period_ns: 0,
        patience_ns: PATIENCE_NS,
        absent_after: ABSENT_AFTER,
        decision_interval: cast.decision_interval,
        safe_action: cast.safe_action,
        episodes: None,
        tick_interval_ns: 0,
    }
}
