//! A team as its messages tell of it: who is there, who answers, and how well.

use std::collections::BTreeMap;

use sortie_core::wire::{
    ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameKind, FrameView, Role, StatMsg,
};
use sortie_envs::Split;
use sortie_ipc::{DomainFacts, Heard, HostProcess, model_text};

use super::overview::{Agent, Allocated, Moment, Overview, Process, Standing};
use super::seat::Seat;
use super::window::{WINDOW_S, Window, covered_s};
use crate::environment::ScenarioSetName;
use crate::failure::Failure;
use crate::listener::Missed;

/// What somebody knows who has listened to a team.
pub(super) struct Team {
    domain: String,
    facts: DomainFacts,
    format: FrameFormat,
    /// By number, where all agents have the same ones.
    actions: Vec<String>,
    began_ns: u64,
    newest_tick: Option<u64>,
    moment: Option<Moment>,
    /// The frame that is being answered, and the one before: what was missed of a tick shows in the next one.
    open: Option<Tick>,
    closed: Option<Tick>,
    allocation: Option<AllocMsg>,
    processes: BTreeMap<u32, StatMsg>,
    /// `[A]`
    seats: Vec<Seat>,
    missed: Missed,
    recent: Window<Counts>,
    total: Counts,
}

/// What a team does besides acting.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    ticks: u64,
    allocations: u64,
}

/// A frame that asks for actions; bit a stands for agent a.
#[derive(Clone, Copy, Debug)]
struct Tick {
    number: u64,
    asked: u64,
    /// Those whose policy answered before the next frame.
    answered: u64,
    /// Messages that had been missed before.
    missed: u64,
}

impl Team {
    pub(super) fn new(domain: &str, facts: &DomainFacts, now_ns: u64) -> Result<Self, Failure> {
        let agents = facts.shape().agents;
        Ok(Self {
            domain: domain.to_owned(),
            facts: facts.clone(),
            format: facts.format()?,
            actions: action_names(facts),
            began_ns: now_ns,
            newest_tick: None,
            moment: None,
            open: None,
            closed: None,
            allocation: None,
            processes: BTreeMap::new(),
            seats: std::iter::repeat_with(Seat::default).take(agents).collect(),
            missed: Missed::default(),
            recent: Window::default(),
            total: Counts::default(),
        })
    }

    /// Takes in a message that was read at this time of the domain's clock. Returns whether the team ends with it.
    pub(super) fn hear(&mut self, heard: Heard<'_>, now_ns: u64) -> bool {
        self.missed.note(heard);
        match heard {
            Heard::Frame(header, payload) => {
                self.begin(header, payload, now_ns);
                return header.has(FrameHeader::SHUTDOWN);
            }
            Heard::Allocation(it) => self.allocate(it, now_ns),
            Heard::Action(it) => self.act(it, now_ns),
            Heard::Status(it) if it.has(StatMsg::BYE) => {
                self.processes.remove(&it.pid);
            }
            Heard::Status(it) => {
                self.processes.insert(it.pid, *it);
            }
        }
        false
    }

    fn begin(&mut self, header: &FrameHeader, payload: &[u8], now_ns: u64) {
        // Frames that only warm caches are of no tick.
        if header.kind == FrameKind::WarmUp as u16 {
            return;
        }
        let Ok(view) = FrameView::new(header, payload, &self.format) else { return };
        self.advance(header.tick, now_ns);
        self.compare(&view);
        self.judge(now_ns);
        self.moment = Some(Moment {
            world_term: header.world_term,
            // Its upper half is the world's term.
            tick: header.tick as u32,
            episode: header.episode,
            step: view.step(),
            paused: header.has(FrameHeader::PAUSED),
        });
        let (present, absent) = (view.present(), view.absent());
        let mut asked = 0;
        for (agent, seat) in self.seats.iter_mut().enumerate() {
            seat.standing = match (present.contains(agent), absent >> agent & 1) {
                (false, _) => Standing::Missing,
                (true, 1) => Standing::Absent,
                (true, _) => Standing::Plays,
            };
            asked |= u64::from(present.contains(agent)) << agent;
        }
        if header.asks_for_actions() {
            let missed = self.missed.count();
            self.open = Some(Tick { number: header.tick, asked, answered: 0, missed });
        }
    }

    fn advance(&mut self, tick: u64, now_ns: u64) {
        let before = self.newest_tick.unwrap_or(tick);
        if tick < before {
            return;
        }
        self.newest_tick = Some(tick);
        // Another world counts from its own first tick.
        let is_same_world = tick >> 32 == before >> 32;
        let ticks = if is_same_world { tick - before } else { 1 };
        self.recent.at(now_ns).ticks += ticks;
        self.total.ticks += ticks;
    }

    /// Whether agents did what they answered, by what the next frame says that they did. An answer after the deadline may have
    /// come in time all the same: the world was late as well.
    fn compare(&mut self, next: &FrameView<'_>) {
        // Where an episode was given up nobody says what was done last.
        if next.header().has(FrameHeader::EPISODE_START) {
            self.open = None;
        }
        let Some(tick) = &mut self.open else { return };
        for (agent, seat) in self.seats.iter().enumerate() {
            let done = next.last_actions().get(agent);
            if seat.answer_to(tick.number) != done.copied() {
                tick.answered &= !(1 << agent);
            }
        }
    }

    /// Counts who has not answered the frame before the last one, unless something was missed meanwhile.
    fn judge(&mut self, now_ns: u64) {
        if let Some(tick) = self.closed.take().filter(|tick| tick.missed == self.missed.count()) {
            for (agent, seat) in self.seats.iter_mut().enumerate() {
                if tick.asked >> agent & 1 == 1 {
                    seat.judge(tick.answered >> agent & 1 == 1, now_ns);
                }
            }
        }
        self.closed = self.open.take();
    }

    fn allocate(&mut self, it: &AllocMsg, now_ns: u64) {
        if self.allocation.is_none_or(|newest| newest.order() < it.order()) {
            self.allocation = Some(*it);
            self.recent.at(now_ns).allocations += 1;
            self.total.allocations += 1;
        }
    }

    fn act(&mut self, it: &ActionMsg, now_ns: u64) {
        let Some(seat) = self.seats.get_mut(usize::from(it.agent)) else { return };
        if it.has(ActionMsg::BYE) {
            seat.leave(it.runner);
            return;
        }
        seat.take(it, now_ns);
        if let Some(tick) = &mut self.open
            && tick.number == it.tick
            && !it.has(ActionMsg::FALLBACK)
        {
            tick.answered |= 1 << it.agent;
        }
        self.advance(it.tick, now_ns);
    }

    /// What is known at this time of the domain's clock.
    pub(super) fn overview(&self, now_ns: u64) -> Overview {
        let window_s = covered_s(self.began_ns, now_ns);
        let lately = |count: fn(&Counts) -> u64| {
            let sum: u64 = self.recent.recent(now_ns).map(count).sum();
            // A window that has just begun has no rate yet.
            if window_s > 0.0 { sum as f64 / window_s } else { 0.0 }
        };
        let field = |name| self.facts.contract().get(name).and_then(toml::Value::as_str);
        let period_ns = self.facts.period_ns();
        let worlds = self.processes.values().filter(|it| it.role == Role::World as u8);
        Overview {
            domain: self.domain.clone(),
            environment: field("environment").map(str::to_owned),
            allocator: self.facts.allocation().map(str::to_owned),
            rate_hz: (period_ns > 0).then(|| 1e9 / period_ns as f64),
            window_s,
            ticks_per_s: lately(|counts| counts.ticks),
            ticks_total: self.total.ticks,
            missed_total: self.missed.count(),
            degraded: worlds.max_by_key(|it| it.t_ns).is_some_and(|it| it.has(StatMsg::DEGRADED)),
            frame: self.moment,
            allocation: self.allocation.map(|it| Allocated {
                per_s: lately(|counts| counts.allocations),
                ..self.allocated(&it, now_ns)
            }),
            processes: self.told_processes(now_ns),
            agents: self.told_agents(now_ns),
        }
    }

    fn allocated(&self, it: &AllocMsg, now_ns: u64) -> Allocated {
        Allocated {
            term: it.term,
            epoch: it.epoch,
            age_s: now_ns.saturating_sub(it.t_ns) as f64 / 1e9,
            age_ticks: self.newest_tick.unwrap_or(it.tick).saturating_sub(it.tick),
            decide_us: f64::from(it.decide_ns) / 1e3,
            value: None,
            regret: None,
            per_s: 0.0,
            total: self.total.allocations,
        }
    }

    /// Those who have told of themselves lately, by role; who was killed stays for so long.
    fn told_processes(&self, now_ns: u64) -> Vec<Process> {
        let silent_ms = |it: &StatMsg| now_ns.saturating_sub(it.t_ns) / 1_000_000;
        let lately = self.processes.values().filter(|it| silent_ms(it) < WINDOW_S * 1000);
        let mut told: Vec<&StatMsg> = lately.collect();
        told.sort_by_key(|it| (it.role, it.pid));
        let tell = |it: &StatMsg| Process {
            role: Role::from_number(it.role).map_or("process", Role::name),
            pid: HostProcess::of(it.pid).pid,
            host: HostProcess::of(it.pid).host,
            agents: (0..self.seats.len()).filter(|agent| it.agents >> agent & 1 == 1).collect(),
            model: if it.model == [0; 16] { String::new() } else { model_text(it.model) },
            leads_in_term: self.leads(it).then(|| self.term(it)).flatten(),
            graph: it.has(StatMsg::GRAPH),
            up_s: now_ns.saturating_sub(it.start_ns) / 1_000_000_000,
            silent_ms: silent_ms(it),
        };
        told.into_iter().map(tell).collect()
    }

    /// Whether it leads its role: of several who have said so, those who were killed say it no more.
    fn leads(&self, it: &StatMsg) -> bool {
        let of_role = self.processes.values().filter(|rival| rival.role == it.role);
        let mut rivals = of_role.filter(|rival| rival.has(StatMsg::LEADER));
        it.has(StatMsg::LEADER) && rivals.all(|rival| rival.t_ns <= it.t_ns)
    }

    fn term(&self, it: &StatMsg) -> Option<u32> {
        match Role::from_number(it.role) {
            Some(Role::World) => self.moment.map(|moment| moment.world_term),
            Some(Role::Allocator) => self.allocation.map(|allocation| allocation.term),
            _ => None,
        }
    }

    fn told_agents(&self, now_ns: u64) -> Vec<Agent> {
        let tell = |(agent, seat): (usize, &Seat)| {
            let told = seat.tell(now_ns);
            let name = told.action.and_then(|action| self.actions.get(usize::from(action)));
            Agent { agent, action_name: name.cloned(), ..told }
        };
        self.seats.iter().enumerate().map(tell).collect()
    }
}

/// The names of a domain's actions; none where roles have their own, for the domain does not say who has which.
fn action_names(facts: &DomainFacts) -> Vec<String> {
    let environment = facts.contract().get("environment").and_then(toml::Value::as_str);
    let opened = environment.map(|name| ScenarioSetName::parse(name)?.open(Split::Test));
    let Some(Ok(environment)) = opened else { return Vec::new() };
    let names = facts.contract().get("action_names").and_then(toml::Value::as_array);
    let names = names.filter(|_| environment.spec().roles.is_empty());
    let names = names.into_iter().flatten().filter_map(toml::Value::as_str);
    names.map(str::to_owned).collect()
}
