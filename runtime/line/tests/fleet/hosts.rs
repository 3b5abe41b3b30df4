//! Both ends of a line between hosts: who stands in at home, and the runner that is away.

use std::sync::Arc;

use sortie_core::link::{
    ActionTx, AllocRx, Bell, Clock, Frame, FrameBlock, FrameRx, LinkError, Relay, Serial, StatTx,
    Wake, packet_bytes,
};
use sortie_core::roles::{Identity, Poll, RunnerOptions, RunnerRole};
use sortie_core::wire::{ActionMsg, AllocMsg, FrameHeader, Role, StatMsg};
use sortie_line::{
    Away, FarPoll, FarRunner, Home, HomePort, Joining, Key, LineSettings, Offer, Rest, Taken, Team,
};

use super::air::{Air, SimulatedCarrier};
use super::network::Shared;
use super::planted::Planted;
use super::setup::Setup;
use super::toy::{self, ToyPolicy};

/// At home: what the runner that is away says, it passes on.
pub(crate) struct StandIn {
    relay: Relay<'static, HomePort>,
    home: Home,
}

impl StandIn {
    /// `wake` is called when something has come over the line.
    pub(crate) fn open(
        setup: &Setup,
        (air, line, pid): (Arc<Air>, usize, u32),
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Self {
        let agents = setup.runners[line];
        let team = Team::new(toy::shape(setup.agents), setup.period_ns, line as u16 + 1);
        let wanted = offer(agents);
        let judge = move |offer: &Offer| match *offer == wanted {
            true => Ok(team),
            false => Err("it is another one".to_owned()),
        };
        let home = Home::open(settings(SimulatedCarrier::home(air, line, pid)), judge, wake);
        let home = home.expect("it needs no thread");
        let relay = Relay::new(home.port(), setup.format, agents, packet(setup));
        Self { relay, home }
    }

    /// As the process of a stand-in does.
    pub(crate) fn poll(
        &mut self,
        link: &mut (impl sortie_core::link::AgentLink + Newest),
    ) -> Result<Poll, LinkError> {
        self.relay.turn(link)?;
        if link.newest().is_some_and(|header| header.has(FrameHeader::SHUTDOWN)) {
            self.home.send_last();
            return Ok(Poll::Ended);
        }
        self.home.send();
        Ok(Poll::Wait { until_ns: u64::MAX })
    }
}

/// A link that remembers the newest frame that went through it.
pub(crate) trait Newest {
    fn newest(&self) -> Option<FrameHeader>;
}

/// On the other host.
pub(crate) struct FarProcess {
    setup: Setup,
    network: Shared,
    air: Arc<Air>,
    line: usize,
    pid: u32,
    drift: u64,
    state: State,
    /// It has said that it is cut off.
    is_cut: bool,
    /// Since when it acts, or runs on after a stop.
    pub(crate) since_ns: u64,
}

enum State {
    Joining(Box<Joining>),
    Acting(Box<FarRunner<'static, Watched>>, &'static Rest),
}

impl FarProcess {
    pub(crate) fn new(
        setup: &Setup,
        network: Shared,
        (air, line, pid): (Arc<Air>, usize, u32),
        drift: u64,
    ) -> Self {
        let state = State::Joining(joining(setup, &air, (line, pid), drift));
        let setup = setup.clone();
        Self { setup, network, air, line, pid, drift, state, is_cut: false, since_ns: 0 }
    }

    /// As `sortie join` does. The time until which it waits is one of the fleet.
    pub(crate) fn poll(&mut self, now_ns: u64) -> Result<Poll, LinkError> {
        let polled = match &mut self.state {
            State::Joining(joining) => match joining.poll().expect("the team takes it") {
                Some(taken) => {
                    self.act(taken, now_ns)?;
                    Poll::Again
                }
                None => Poll::Wait { until_ns: now_ns + joining.due().as_nanos() as u64 },
            },
            State::Acting(runner, rest) => match runner.poll(&mut ToyPolicy)? {
                FarPoll::Again => Poll::Again,
                FarPoll::Ended => Poll::Ended,
                FarPoll::Wait { until_ns } => {
                    Poll::Wait { until_ns: now_ns + until_ns.saturating_sub(rest.now_ns()) }
                }
                FarPoll::CutOff => {
                    if self.setup.planted != Some(Planted::CutUnsaid) {
                        self.is_cut = true;
                        self.network.borrow_mut().oracle.cut_off(now_ns, self.pid);
                    }
                    Poll::Again
                }
                FarPoll::Heard => {
                    self.is_cut = false;
                    Poll::Again
                }
                FarPoll::Replaced => {
                    let Self { setup, air, line, pid, drift, .. } = self;
                    self.state = State::Joining(joining(setup, air, (*line, *pid), *drift));
                    self.is_cut = false;
                    Poll::Again
                }
            },
        };
        self.check_cut(now_ns);
        Ok(polled)
    }

    /// Who has heard nothing for long has said so.
    fn check_cut(&self, now_ns: u64) {
        if matches!(self.state, State::Acting(..)) && !self.is_cut {
            let heard_ns = self.air.heard_ns(self.pid).unwrap_or_default().max(self.since_ns);
            self.network.borrow_mut().oracle.believes_heard(now_ns, self.pid, heard_ns);
        }
    }

    fn act(&mut self, Taken { line, .. }: Taken, now_ns: u64) -> Result<(), LinkError> {
        let Self { setup, network, .. } = self;
        network.borrow_mut().oracle.session_begins(now_ns, self.pid);
        let rest: &'static Rest = Box::leak(Box::new(line.rest()));
        let shape = toy::shape(setup.agents);
        // A seed's few kilobytes: what is borrowed for as long as a link is borrowed for good.
        let memory = vec![FrameBlock::zeroed(); FrameBlock::for_serial(shape)].leak();
        let link = Serial::new(line.clone(), rest, setup.format, memory, packet(setup))?;
        let link = Watched { link, network: network.clone(), pid: self.pid };
        let role = RunnerRole::new(RunnerOptions {
            format: setup.format,
            identity: Identity::new(self.pid, "away"),
            agents: setup.runners[self.line],
            subtasks: true,
            decision_interval: setup.decision_interval,
            period_ns: setup.period_ns,
            safe_action: Some(toy::SAFE),
        });
        let runner = FarRunner::join(role, link, (line, rest), setup.period_ns)?;
        self.since_ns = now_ns;
        self.state = State::Acting(Box::new(runner), rest);
        Ok(())
    }

    pub(crate) fn leave(&mut self) -> Result<(), LinkError> {
        match &mut self.state {
            State::Joining(_) => Ok(()),
            State::Acting(runner, _) => runner.leave(),
        }
    }
}

fn joining(setup: &Setup, air: &Arc<Air>, (line, pid): (usize, u32), drift: u64) -> Box<Joining> {
    let carrier = SimulatedCarrier::away(Arc::clone(air), line, pid, drift);
    let joining = Joining::new(settings(carrier), &offer(setup.runners[line]));
    Box::new(joining.expect("there are random numbers"))
}

fn settings(carrier: Arc<SimulatedCarrier>) -> LineSettings {
    LineSettings { carrier, key: Key::plain(), copies: 1 }
}

fn offer(agents: u64) -> Offer {
    Offer { abi: sortie_core::wire::ABI, contract: 7, model: [1; 16], agents }
}

fn packet(setup: &Setup) -> &'static mut [u8] {
    vec![0; packet_bytes(toy::shape(setup.agents))].leak()
}

/// A runner's link, of which the oracle is told what goes through it.
struct Watched {
    link: Serial<'static, Away>,
    network: Shared,
    pid: u32,
}

impl FrameRx for Watched {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        let is_accepted = self.link.receive_frames(accept)?;
        if let Some(frame) = self.link.frame().filter(|_| is_accepted) {
            self.network.borrow_mut().oracle.frame_kept(self.pid, frame.header);
        }
        Ok(is_accepted)
    }

    fn frame(&self) -> Option<Frame<'_>> {
        self.link.frame()
    }
}

impl AllocRx for Watched {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        let Self { link, network, pid } = self;
        link.receive_allocations(&mut |allocation| {
            network.borrow_mut().oracle.allocation_seen(*pid, allocation);
            take(allocation);
        })
    }
}

impl ActionTx for Watched {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        let mut network = self.network.borrow_mut();
        let now_ns = network.now_ns;
        network.oracle.said_away(now_ns, self.pid, action);
        drop(network);
        self.link.send_action(action)
    }
}

impl StatTx for Watched {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        self.link.send_status(status)
    }
}

impl Bell for Watched {
    fn token(&self) -> u32 {
        self.link.token()
    }

    fn wait_until(&mut self, _: u32, _: u64) -> Wake {
        Wake::Timeout
    }

    fn ring(&mut self, role: Role) -> Result<(), LinkError> {
        self.link.ring(role)
    }
}

impl Clock for Watched {
    fn now_ns(&self) -> u64 {
        self.link.now_ns()
    }
}
