//! Knows everything that was sent and seen, and holds the fleet to its invariants.

use std::collections::BTreeMap;
use std::fmt;
use std::rc::Rc;

use sortie_core::roles::TickReport;
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader, FrameKind, FrameView};
use sortie_core::{Allocator, NO_ACTION, UNASSIGNED};
use zerocopy::IntoBytes;

use super::crossing::Crossing;
use super::network::SentFrame;
use super::setup::{MILLISECOND, Setup, Weather};
use super::toy;

/// A leader's first allocation comes within this time.
const TAKEOVER_NS: u64 = 10 * MILLISECOND;
/// How much later than its deadline a tick may end.
const LATENESS_NS: u64 = MILLISECOND;
/// Ticks in a row after which a silent agent is absent: three, and three more each time that a process
/// for its seat is heard of meanwhile.
const SILENT_TICKS: u32 = 10;
/// Ticks that are remembered.
const MEMORY: usize = 400;

/// What always holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Invariant {
    /// A tick ends at its deadline at the latest, and the next one comes.
    TicksInTime,
    /// In every tick, every agent that is present gets an action that is available, and nobody else does.
    EveryAgentActs,
    /// An agent that is silent in tick after tick is absent, and nobody else is.
    SilenceIsNoticed,
    /// What the world takes for an answer is one, given to this frame.
    AnswersAreGiven,
    /// An agent acts on a valid allocation, or on the stated fallback, and says which.
    StatedAllocation,
    /// Nobody acts on an allocation of an earlier term or epoch than the newest one seen.
    NoOldTerm,
    /// Nobody answers anything but the newest frame seen.
    NoOldFrame,
    /// Only agents that are present, and not absent, are allocated, and only to open subtasks.
    Feasible,
    /// Allocations come from the holder of the lock only, in rising order.
    OneLeader,
    /// A new leader allocates at once.
    TakenOver,
    /// Nobody finds, when its time is over, what it was to be woken for.
    WokenAfterData,
    /// One process on all hosts acts for an agent: whose session was followed by another one's is heard no more.
    OneSeat,
    /// What crosses between hosts was said there, in a session that goes on, and is newer than all before.
    NothingOld,
    /// A runner that hears nothing of its team says so, and does nothing.
    SaysSo,
    /// Some time after the last disturbance all agents act in time, on fresh allocations.
    Recovered,
    /// When the world ends, everyone does.
    Ends,
    /// No role fails but by being killed.
    NoFailure,
}

#[derive(Clone, Debug)]
pub(crate) struct Violation {
    pub(crate) invariant: Invariant,
    pub(crate) now_ns: u64,
    pub(crate) detail: String,
}

/// How often a run came to the places that matter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Coverage {
    pub(crate) ticks: u64,
    pub(crate) calm_ticks: u64,
    pub(crate) fallbacks: u64,
    pub(crate) stale: u64,
    pub(crate) unallocated: u64,
    pub(crate) by_heuristic: u64,
    pub(crate) takeovers: u64,
    pub(crate) worlds: u64,
    pub(crate) degraded: u64,
    pub(crate) step_downs: u64,
    pub(crate) sessions: u64,
    pub(crate) cuts_told: u64,
    pub(crate) passed_on: u64,
}

impl Coverage {
    /// Whether runs of so many seeds came to every place; the first leader and the first world do not count.
    pub(crate) fn reaches_everything(&self, seeds: u64) -> bool {
        let Self { ticks, calm_ticks, fallbacks, stale, unallocated, .. } = *self;
        let Self { by_heuristic, takeovers, worlds, degraded, step_downs, .. } = *self;
        let (takeovers, worlds) = (takeovers.saturating_sub(seeds), worlds.saturating_sub(seeds));
        let agents = [fallbacks, stale, unallocated, by_heuristic];
        let fleet = [ticks, calm_ticks, takeovers, worlds, degraded, step_downs];
        let hosts = [self.sessions, self.cuts_told, self.passed_on];
        agents.into_iter().chain(fleet).chain(hosts).all(|count| count > 0)
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.ticks += other.ticks;
        self.calm_ticks += other.calm_ticks;
        self.fallbacks += other.fallbacks;
        self.stale += other.stale;
        self.unallocated += other.unallocated;
        self.by_heuristic += other.by_heuristic;
        self.takeovers += other.takeovers;
        self.worlds += other.worlds;
        self.degraded += other.degraded;
        self.step_downs += other.step_downs;
        self.sessions += other.sessions;
        self.cuts_told += other.cuts_told;
        self.passed_on += other.passed_on;
    }
}

/// What one process has seen.
#[derive(Default)]
struct Reader {
    /// The newest frame that it took.
    kept_tick: u64,
    /// Since when it has a frame.
    since_ns: Option<u64>,
    newest: Option<AllocMsg>,
}

struct Leader {
    pid: u32,
    term: u32,
    since_ns: u64,
    has_allocated: bool,
}

pub(crate) struct Oracle {
    setup: Setup,
    frames: BTreeMap<u64, Rc<SentFrame>>,
    answers: BTreeMap<u64, Vec<ActionMsg>>,
    newest_order: (u32, u32),
    readers: BTreeMap<u32, Reader>,
    leader: Option<Leader>,
    /// Ticks in a row in which nobody acted for each agent.
    silent: Vec<u32>,
    crossing: Crossing,
    calm_since_ns: u64,
    /// The world runs, undisturbed, since then.
    world_since_ns: Option<u64>,
    pub(crate) coverage: Coverage,
    pub(crate) violation: Option<Violation>,
    trace: Option<Vec<String>>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Freshness {
    Fresh,
    Stale,
    None,
}

impl Oracle {
    pub(crate) fn new(setup: Setup, traces: bool) -> Self {
        Self {
            silent: vec![0; setup.agents],
            setup,
            frames: BTreeMap::new(),
            answers: BTreeMap::new(),
            newest_order: (0, 0),
            readers: BTreeMap::new(),
            leader: None,
            crossing: Crossing::default(),
            calm_since_ns: 0,
            world_since_ns: None,
            coverage: Coverage::default(),
            violation: None,
            trace: traces.then(Vec::new),
        }
    }

    pub(crate) fn into_trace(self) -> Vec<String> {
        self.trace.unwrap_or_default()
    }

    /// Writes a line of the trace, if there is one.
    pub(crate) fn note(&mut self, now_ns: u64, line: impl FnOnce() -> String) {
        if let Some(trace) = &mut self.trace {
            trace.push(format!("{:11.3} ms  {}", now_ns as f64 / 1e6, line()));
        }
    }

    /// The first violation counts.
    pub(crate) fn violate(&mut self, invariant: Invariant, now_ns: u64, detail: String) {
        self.note(now_ns, || format!("VIOLATION of {invariant:?}: {detail}"));
        self.violation.get_or_insert(Violation { invariant, now_ns, detail });
    }

    fn is_hostile(&self) -> bool {
        self.setup.weather == Weather::Hostile
    }

    /// Something happened to the fleet, and lasts until then.
    pub(crate) fn disturb(&mut self, until_ns: u64) {
        self.calm_since_ns = self.calm_since_ns.max(until_ns);
    }

    pub(crate) fn is_calm(&self, now_ns: u64) -> bool {
        now_ns >= self.calm_since_ns + self.setup.recovery_ns()
    }

    /// The world was started, or ran on after a stop.
    pub(crate) fn world_runs(&mut self, since_ns: u64) {
        self.world_since_ns = Some(since_ns);
    }

    pub(crate) fn world_is_gone(&mut self) {
        self.world_since_ns = None;
        // The next one knows nobody.
        self.silent.fill(0);
    }

    /// A process acquired the allocator's lock.
    pub(crate) fn leads(&mut self, now_ns: u64, pid: u32, term: u32) {
        self.note(now_ns, || format!("allocator {pid} leads term {term}"));
        self.leader = Some(Leader { pid, term, since_ns: now_ns, has_allocated: false });
    }

    /// The leader was stopped until then.
    pub(crate) fn leader_runs(&mut self, pid: u32, since_ns: u64) {
        if let Some(leader) = self.leader.as_mut().filter(|leader| leader.pid == pid) {
            leader.since_ns = leader.since_ns.max(since_ns);
        }
    }

    pub(crate) fn leader_is_gone(&mut self, pid: u32) {
        self.leader = self.leader.take().filter(|leader| leader.pid != pid);
    }

    /// What has to happen by now.
    pub(crate) fn check_time(&mut self, now_ns: u64) {
        let Setup { period_ns, patience_ns, tick_interval_ns, .. } = self.setup;
        let bound = (period_ns + patience_ns + tick_interval_ns) + 50 * MILLISECOND;
        if let Some(since) = self.world_since_ns.filter(|since| now_ns > since + bound) {
            let detail = format!("no tick since {:.3} ms", since as f64 / 1e6);
            self.violate(Invariant::TicksInTime, now_ns, detail);
        }
        let Some(Leader { pid, since_ns, has_allocated: false, .. }) = self.leader else { return };
        let ready = self.readers.get(&pid).and_then(|reader| reader.since_ns);
        if !self.is_hostile()
            && ready.is_some_and(|ready| now_ns > ready.max(since_ns) + TAKEOVER_NS)
        {
            self.violate(
                Invariant::TakenOver,
                now_ns,
                format!("allocator {pid} does not allocate"),
            );
        }
    }

    pub(crate) fn frame_sent(&mut self, frame: &Rc<SentFrame>) {
        if frame.header.kind == FrameKind::World as u16 {
            self.frames.insert(frame.header.tick, frame.clone());
            if self.frames.len() > MEMORY {
                self.frames.pop_first();
            }
        }
        let FrameHeader { t_ns, tick, flags, kind, .. } = frame.header;
        self.note(t_ns, || format!("world: frame {} kind {kind} flags {flags:#x}", Tick(tick)));
    }

    pub(crate) fn frame_kept(&mut self, pid: u32, header: &FrameHeader) {
        let reader = self.readers.entry(pid).or_default();
        if header.kind == FrameKind::World as u16 {
            reader.kept_tick = reader.kept_tick.max(header.tick);
            reader.since_ns.get_or_insert(header.t_ns + 2 * MILLISECOND);
        }
    }

    pub(crate) fn allocation_seen(&mut self, pid: u32, allocation: &AllocMsg) {
        let format = &self.setup.format;
        if allocation.check(format.schema, format.layout.shape()).is_err() {
            return;
        }
        let reader = self.readers.entry(pid).or_default();
        if reader.newest.is_none_or(|newest| newest.order() < allocation.order()) {
            reader.newest = Some(*allocation);
        }
    }

    pub(crate) fn allocation_sent(&mut self, now_ns: u64, pid: u32, allocation: &AllocMsg) {
        let AllocMsg { tick, term, epoch, flags, .. } = *allocation;
        let tasks = &allocation.task[..self.setup.agents];
        self.note(now_ns, || {
            format!("allocator {pid}: {term}.{epoch} for {} flags {flags:#x} {tasks:?}", Tick(tick))
        });
        let order = allocation.order();
        match &mut self.leader {
            Some(leader)
                if leader.pid == pid && leader.term == term && order > self.newest_order =>
            {
                self.coverage.takeovers += u64::from(!leader.has_allocated);
                leader.has_allocated = true;
                self.newest_order = order;
            }
            _ => {
                let detail = format!("allocator {pid} allocates {order:?} without the lock");
                return self.violate(Invariant::OneLeader, now_ns, detail);
            }
        }
        let is_first = flags & AllocMsg::FIRST_OF_TERM != 0;
        if is_first != (epoch == 1) {
            self.violate(Invariant::OneLeader, now_ns, format!("{order:?} has flags {flags:#x}"));
        }
        if let Some(infeasible) = self.infeasible(allocation).filter(|_| !self.is_hostile()) {
            self.violate(Invariant::Feasible, now_ns, infeasible);
        }
    }

    fn infeasible(&self, allocation: &AllocMsg) -> Option<String> {
        let Some(frame) = self.frames.get(&allocation.tick) else {
            return Some(format!("{} is not known", Tick(allocation.tick)));
        };
        let view = self.view(frame)?;
        (0..self.setup.agents).find_map(|agent| {
            let task = allocation.task_of(agent)?;
            if !view.allocation_state().present.contains(agent) {
                return Some(format!("agent {agent}, which is absent, is given subtask {task}"));
            }
            let is_open = view.open_tasks() >> task & 1 == 1;
            (!is_open).then(|| format!("agent {agent} is given subtask {task}, which is not open"))
        })
    }

    fn view<'a>(&self, frame: &'a SentFrame) -> Option<FrameView<'a>> {
        FrameView::new(&frame.header, frame.payload.as_bytes(), &self.setup.format).ok()
    }

    pub(crate) fn action_sent(&mut self, now_ns: u64, pid: u32, action: &ActionMsg) {
        let ActionMsg { tick, agent, flags, task, alloc_term, alloc_epoch, .. } = *action;
        self.note(now_ns, || {
            let chosen = action.action;
            let order = format!("{alloc_term}.{alloc_epoch}");
            format!("runner {pid}: agent {agent} {} action {chosen} task {task} by {order} flags {flags:#x}", Tick(tick))
        });
        if action.has(ActionMsg::BYE) {
            return;
        }
        self.answers.entry(tick).or_default().push(*action);
        if self.answers.len() > MEMORY {
            self.answers.pop_first();
        }
        // Who stands in answers for nothing: the runner that is away has done so.
        let fault = match self.crossing.is_stand_in(pid) {
            true => {
                self.coverage.passed_on += 1;
                self.crossing.passed_on(action)
            }
            false => self.misstated(pid, action),
        };
        if let Some((invariant, detail)) = fault.filter(|_| !self.is_hostile()) {
            self.violate(invariant, now_ns, format!("runner {pid}, agent {agent}: {detail}"));
        }
    }

    pub(crate) fn stands_in(&mut self, pid: u32, agents: u64) {
        self.crossing.stands_in(pid, agents);
    }

    pub(crate) fn session_begins(&mut self, now_ns: u64, pid: u32) {
        let session = self.crossing.begins(pid);
        self.coverage.sessions += 1;
        self.note(now_ns, || format!("runner {pid}: session {session} begins"));
    }

    pub(crate) fn cut_off(&mut self, now_ns: u64, pid: u32) {
        self.note(now_ns, || format!("runner {pid} is cut off, and says so"));
        self.coverage.cuts_told += 1;
        self.crossing.cut_off(pid);
    }

    pub(crate) fn believes_heard(&mut self, now_ns: u64, pid: u32, heard_ns: u64) {
        if let Some((invariant, detail)) = self.crossing.believes_heard(now_ns, heard_ns, pid) {
            self.violate(invariant, now_ns, detail);
        }
    }

    /// A runner on another host answers.
    pub(crate) fn said_away(&mut self, now_ns: u64, pid: u32, action: &ActionMsg) {
        if let Some((invariant, detail)) = self.crossing.said(pid, action) {
            self.violate(invariant, now_ns, detail);
        }
        self.action_sent(now_ns, pid, action);
    }

    fn misstated(&self, pid: u32, action: &ActionMsg) -> Option<(Invariant, String)> {
        let reader = self.readers.get(&pid)?;
        let frame = self.frames.get(&action.tick).filter(|_| reader.kept_tick == action.tick);
        let Some(view) = frame.and_then(|frame| self.view(frame)) else {
            let detail =
                format!("answers {}, newest {}", Tick(action.tick), Tick(reader.kept_tick));
            return Some((Invariant::NoOldFrame, detail));
        };
        let order = (action.alloc_term, action.alloc_epoch);
        let newest = reader.newest.as_ref();
        if order != (0, 0) && newest.is_some_and(|newest| order < newest.order()) {
            let newest = newest.map(AllocMsg::order);
            return Some((Invariant::NoOldTerm, format!("acts on {order:?}, has seen {newest:?}")));
        }
        let agent = usize::from(action.agent);
        let freshness = newest.map_or(Freshness::None, |newest| self.freshness(newest, &view));
        let (want_order, want_task) = match (newest, freshness) {
            (Some(newest), Freshness::Fresh | Freshness::Stale) => {
                (newest.order(), newest.task[agent])
            }
            _ => ((0, 0), self.fallback_task(&view, agent)),
        };
        let is_closed = want_task != UNASSIGNED && view.open_tasks() >> want_task & 1 == 0;
        let want_flags = match freshness {
            Freshness::Fresh if is_closed => ActionMsg::STALE_ALLOC,
            Freshness::Fresh => 0,
            Freshness::Stale => ActionMsg::STALE_ALLOC,
            Freshness::None => ActionMsg::NO_ALLOC,
        };
        let flags = action.flags & (ActionMsg::STALE_ALLOC | ActionMsg::NO_ALLOC);
        if (order, action.task, flags) != (want_order, want_task, want_flags) {
            let want = format!("{want_order:?}, subtask {want_task}, flags {want_flags:#x}");
            return Some((
                Invariant::StatedAllocation,
                format!(
                    "acts on {order:?}, subtask {}, flags {flags:#x}; should on {want}",
                    action.task
                ),
            ));
        }
        let available = view.available(agent);
        let is_available =
            |one: u16| available.get(usize::from(one)).is_some_and(|&code| code != 0);
        let lowest =
            (0..available.len() as u16).find(|&one| is_available(one)).unwrap_or(NO_ACTION);
        let safe = if is_available(toy::SAFE) { toy::SAFE } else { lowest };
        let is_right = match action.task {
            UNASSIGNED => action.action == safe,
            _ => is_available(action.action) || lowest == NO_ACTION && action.action == NO_ACTION,
        };
        let detail = || (Invariant::StatedAllocation, format!("does {}", action.action));
        (!is_right).then(detail)
    }

    fn freshness(&self, newest: &AllocMsg, view: &FrameView<'_>) -> Freshness {
        let tick = view.header().tick;
        let interval = u64::from(self.setup.decision_interval);
        let intervals = if self.setup.pipelined { 2 } else { 1 };
        let valid_until = newest.tick + intervals * interval;
        let is_fresh = if self.setup.pipelined {
            tick <= valid_until
        } else {
            newest.tick >= view.decision_tick()
        };
        match () {
            () if newest.tick < tick - u64::from(view.step()) => Freshness::None,
            () if is_fresh => Freshness::Fresh,
            () if tick <= valid_until + 2 * interval => Freshness::Stale,
            () => Freshness::None,
        }
    }

    /// The subtask of an agent without a usable allocation.
    fn fallback_task(&self, view: &FrameView<'_>, agent: usize) -> u8 {
        let mut tasks = vec![UNASSIGNED; self.setup.agents];
        let mut costs = vec![0.0; self.setup.agents * toy::TASKS];
        // A runner on another host has no rule: it does not see all of the frame.
        if self.setup.heuristic && !self.setup.is_away(agent) {
            let allocated =
                toy::heuristic(&mut costs).allocate(&view.allocation_state(), &mut tasks);
            allocated.expect("the heuristic refuses nothing");
        }
        tasks[agent]
    }

    /// The world has stepped.
    pub(crate) fn ticked(&mut self, now_ns: u64, report: &TickReport<'_>) {
        let tick = report.tick;
        self.note(now_ns, || {
            let (actions, answered) = (report.actions, report.answered);
            format!(
                "world: {} step {} done: actions {actions:?} answered {answered:#b}",
                Tick(tick),
                report.step
            )
        });
        self.coverage.ticks += 1;
        self.coverage.degraded += u64::from(report.degraded);
        let Some(frame) = self.frames.get(&tick).cloned() else {
            return self.violate(
                Invariant::TicksInTime,
                now_ns,
                format!("{} was never sent", Tick(tick)),
            );
        };
        let Some(view) = self.view(&frame) else { return };
        let since = self.world_since_ns.replace(now_ns).unwrap_or(now_ns);
        let late_by = now_ns.saturating_sub(frame.header.deadline_ns.max(since));
        if late_by > LATENESS_NS {
            let detail = format!("{} ends {late_by} ns after its deadline", Tick(tick));
            self.violate(Invariant::TicksInTime, now_ns, detail);
        }
        let is_calm = !self.is_hostile() && self.is_calm(report.published_ns);
        self.coverage.calm_ticks += u64::from(is_calm);
        for agent in 0..self.setup.agents {
            let fault = self
                .wrong_action(report, &view, agent)
                .or_else(|| self.ungiven(report, agent))
                .or_else(|| self.unrecovered(report, &view, agent).filter(|_| is_calm))
                .or_else(|| self.wrongly_absent(report, &view, agent));
            self.count(report, &view, agent);
            if let Some((invariant, detail)) = fault {
                self.violate(invariant, now_ns, format!("{}, agent {agent}: {detail}", Tick(tick)));
            }
        }
    }

    fn count(&mut self, report: &TickReport<'_>, view: &FrameView<'_>, agent: usize) {
        let Coverage { fallbacks, stale, unallocated, by_heuristic, .. } = &mut self.coverage;
        if report.answered >> agent & 1 == 0 {
            *fallbacks += u64::from(view.present().contains(agent));
            return;
        }
        let answer = &report.answers[agent];
        let is_unallocated = answer.has(ActionMsg::NO_ALLOC);
        *stale += u64::from(answer.has(ActionMsg::STALE_ALLOC));
        *unallocated += u64::from(is_unallocated);
        *by_heuristic += u64::from(is_unallocated && answer.task != UNASSIGNED);
    }

    fn wrong_action(
        &self,
        report: &TickReport<'_>,
        view: &FrameView<'_>,
        agent: usize,
    ) -> Option<(Invariant, String)> {
        let action = report.actions[agent];
        let available = view.available(agent);
        let is_available = available.get(usize::from(action)).is_some_and(|&code| code != 0);
        let may_rest = available.iter().all(|&code| code == 0) || self.is_hostile();
        let is_right = match view.present().contains(agent) {
            true => is_available || action == NO_ACTION && may_rest,
            false => action == NO_ACTION,
        };
        (!is_right).then(|| (Invariant::EveryAgentActs, format!("does {action}")))
    }

    fn ungiven(&self, report: &TickReport<'_>, agent: usize) -> Option<(Invariant, String)> {
        if report.answered >> agent & 1 == 0 || self.is_hostile() {
            return None;
        }
        let answer = &report.answers[agent];
        let given = self.answers.get(&report.tick).is_some_and(|answers| answers.contains(answer));
        let is_applied = report.actions[agent] == answer.action;
        let is_right = given && is_applied && usize::from(answer.agent) == agent;
        (!is_right).then(|| (Invariant::AnswersAreGiven, format!("{answer:?} is applied")))
    }

    fn wrongly_absent(
        &mut self,
        report: &TickReport<'_>,
        view: &FrameView<'_>,
        agent: usize,
    ) -> Option<(Invariant, String)> {
        let is_absent = view.absent() >> agent & 1 == 1;
        let before = self.silent[agent];
        if report.answered >> agent & 1 == 1 {
            self.silent[agent] = 0;
        } else if view.present().contains(agent) {
            self.silent[agent] += 1;
        }
        if is_absent {
            // Another process that takes the place is counted on at once, and may be silent as well.
            self.silent[agent] = self.silent[agent].min(3);
        }
        let is_wrong = if is_absent { before < 3 } else { before > SILENT_TICKS };
        let detail = || {
            let word = if is_absent { "absent" } else { "counted on" };
            (Invariant::SilenceIsNoticed, format!("is {word} after {before} silent ticks"))
        };
        (is_wrong && self.setup.weather != Weather::Hostile).then(detail)
    }

    fn unrecovered(
        &self,
        report: &TickReport<'_>,
        view: &FrameView<'_>,
        agent: usize,
    ) -> Option<(Invariant, String)> {
        if !view.present().contains(agent) {
            return None;
        }
        let fault = |detail: String| Some((Invariant::Recovered, detail));
        if report.answered >> agent & 1 == 0 {
            return fault("does not act, long after the last disturbance".into());
        }
        let answer = &report.answers[agent];
        // Pipelined agents begin an episode without an allocation, and a subtask may just have closed.
        let may_lack = self.setup.pipelined && report.step <= 2;
        let may_be_stale =
            view.open_tasks().checked_shr(answer.task.into()).is_some_and(|open| open & 1 == 0);
        if answer.has(ActionMsg::NO_ALLOC) && !may_lack {
            return fault("has no allocation, long after the last disturbance".into());
        }
        if answer.has(ActionMsg::STALE_ALLOC) && !may_be_stale {
            return fault("has a stale allocation, long after the last disturbance".into());
        }
        None
    }
}

/// A tick as its world's term and its count.
struct Tick(u64);

impl fmt::Display for Tick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "tick {}:{}", self.0 >> 32, self.0 as u32)
    }
}
