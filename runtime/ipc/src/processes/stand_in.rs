//! Who stands in a team for a runner on another host: it holds the seats, and passes on what both say. And who stands in for an
//! allocator there: it holds the lead, and asks.

use std::time::Duration;

use sortie_core::link::{
    ActionTx, AllocRx, Bell, Clock, Frame, FrameRx, LinkError, Relay, StatTx, Wake, packet_bytes,
};
use sortie_core::roles::{Counters, Identity, Poll};
use sortie_core::wire::{
    ABI, ActionMsg, AllocMsg, Command, ControlReq, ControlStatus, FrameHeader, Role, StatMsg,
};
use sortie_line::{AllocatorAtHome, Home, HomePort, LineSettings, Offer, Team};

use super::abandoned::Abandoned;
use super::allocator::AllocatorProcess;
use super::children::Parent;
use super::runner::{port_name, seats};
use super::{
    Controlled, FAR_SIGNAL_PATIENCE, Process, ProcessSettings, WORLD_PATIENCE, drive, is_named,
    linger,
};
use crate::domain::{Domain, DomainContract, Lock, Membership, model_text};
use crate::error::Error;
use crate::iox::{IoxAgent, LinkSetup};
use crate::process_info::ProcessInfo;
use crate::stop::{Stop, Wakeable};

/// The share of a period within which an allocator on another host answers.
const SHARE_OF_PERIOD: f64 = 0.35;
/// The same for a team without a period.
const PATIENCE: Duration = Duration::from_millis(100);
/// Behind those of all runners' hosts.
const ALLOCATORS_HOST: u16 = 65;

/// Stands for the runner of `agents` on another host, in this thread, until the world ends. The seats are taken whether or not
/// anybody is at the other end: without it the agents' fallbacks act, and nobody else can.
///
/// # Errors
/// No world comes, it runs another contract or has private frames, another process acts for one of the agents, the address
/// cannot be listened at, or a signal came.
pub fn stand_in_process(
    domain: &Domain,
    contract: &DomainContract,
    agents: &[u16],
    line: LineSettings,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<(), Error> {
    let parent = Parent::follow(settings.parent)?;
    let membership = domain.enter()?;
    let facts = membership.await_facts(contract, WORLD_PATIENCE, stop)?;
    let seats = seats(agents, facts.shape().agents)?;
    facts.check_frames(domain, false)?;
    let locks = agents.iter().map(|&agent| membership.take_seat(agent));
    let _locks: Vec<Lock> = locks.collect::<Result<_, _>>()?;
    let (format, name) = (facts.format()?, port_name(agents));
    let mut link = {
        let _starting = membership.lock_start()?;
        let linger = linger(settings.linger, facts.period_ns() != 0);
        let setup = LinkSetup { domain, format, name: &name, bell: facts.bell(), linger };
        IoxAgent::open(&setup)?
    };
    let team = Team::new(facts.shape(), facts.period_ns(), host_of(seats));
    let wanted = Offer { abi: ABI, contract: contract.hash, model: settings.model, agents: seats };
    let waker = link.waker();
    let judge = move |offer: &Offer| check(offer, &wanted).map(|()| team);
    let home = Home::open(line, judge, move || waker.wake())?;
    let mut packet = vec![0; packet_bytes(facts.shape())];
    let relay = Relay::new(home.port(), format, seats, &mut packet);
    let identity = settings.identity(&name);
    settings.real_time.claim()?;
    let mut process = StandIn {
        relay,
        home,
        identity,
        seats,
        schema: format.schema,
        counters: Counters::default(),
        tick: 0,
        membership: &membership,
        parent,
        abandoned: Abandoned::new(settings.world_patience),
        is_told_to_end: false,
    };
    drive(&mut process, &mut link, stop)
}

/// Stands for an allocator on another host, in this thread, until the world ends: it leads like any other, asks that one, and leaves
/// the lead to others where no answer comes within 35 % of a period, and while nothing is heard of it.
///
/// # Errors
/// No world comes, it runs another contract, the address cannot be listened at, or a signal came.
pub fn stand_in_allocator_process(
    domain: &Domain,
    contract: &DomainContract,
    line: LineSettings,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<Counters, Error> {
    let mut process = AllocatorProcess::join(domain, contract, settings, stop)?;
    let facts = process.facts()?;
    let team = Team::new(facts.shape(), facts.period_ns(), ALLOCATORS_HOST);
    let wanted = allocator_offer(contract, settings.model);
    let judge = move |offer: &Offer| check(offer, &wanted).map(|()| team);
    let patience = match Duration::from_nanos(facts.period_ns()) {
        Duration::ZERO => PATIENCE,
        period => period.mul_f64(SHARE_OF_PERIOD),
    };
    let waker = process.waker();
    let far = AllocatorAtHome::open(line, judge, patience, move || waker.wake())?;
    let ended = process.allocate_while(&|| far.tend(), &mut &far, stop);
    if ended.is_ok() {
        far.end();
    }
    let left = process.leave();
    ended.and(left)
}

/// What an allocator on another host says of itself. From what it draws and by which rule belongs to its contract.
pub fn allocator_offer(contract: &DomainContract, model: [u8; 16]) -> Offer {
    let DomainContract { hash, allocation, draws, .. } = contract;
    // FNV-1a, from the contract on.
    let mix = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    let contract = format!("{allocation:?} {draws:?}").bytes().fold(*hash, mix);
    Offer { abi: ABI, contract, model, agents: 0 }
}

/// The number of a runner's host: one more than that of its first agent, so that each has its own, and home is 0.
fn host_of(seats: u64) -> u16 {
    // There are 64 agents at most.
    seats.trailing_zeros() as u16 + 1
}

/// Refuses a runner that would do something else than the team's own.
fn check(offer: &Offer, wanted: &Offer) -> Result<(), String> {
    let set = |agents: u64| {
        let agents = (0..64).filter(|agent| agents >> agent & 1 == 1);
        agents.map(|agent: u32| agent.to_string()).collect::<Vec<_>>().join(",")
    };
    let model = |model: [u8; 16]| model_text(model).chars().take(8).collect::<String>();
    let (what, here, there) = if offer.abi != wanted.abi {
        ("ABI of messages", wanted.abi.to_string(), offer.abi.to_string())
    } else if offer.contract != wanted.contract {
        let told = |contract: u64| format!("{contract:016x}");
        let what = if wanted.agents == 0 {
            "contract (by --allocation, --seed and --proposals, too)"
        } else {
            "contract"
        };
        (what, told(wanted.contract), told(offer.contract))
    } else if offer.model != wanted.model {
        ("bundle", model(wanted.model), model(offer.model))
    } else if offer.agents != wanted.agents {
        ("set of agents", set(wanted.agents), set(offer.agents))
    } else {
        return Ok(());
    };
    Err(format!("the {what} is {here} here, {there} there"))
}

struct StandIn<'a> {
    relay: Relay<'a, HomePort>,
    home: Home,
    identity: Identity,
    seats: u64,
    schema: u64,
    counters: Counters,
    tick: u64,
    membership: &'a Membership,
    parent: Option<Parent>,
    abandoned: Abandoned,
    is_told_to_end: bool,
}

impl Process for StandIn<'_> {
    type Link = IoxAgent;

    fn poll(&mut self, link: &mut IoxAgent) -> Result<Poll, Error> {
        let mut overheard = Overheard { link, newest: None };
        self.relay.turn(&mut overheard)?;
        let newest = overheard.newest;
        self.tick = newest.map_or(self.tick, |header| header.tick);
        if newest.is_some_and(|header| header.has(FrameHeader::SHUTDOWN)) {
            self.home.send_last();
            return Ok(Poll::Ended);
        }
        self.home.send();
        Ok(Poll::Wait { until_ns: u64::MAX })
    }

    fn leaves_loop(&self) -> bool {
        self.is_told_to_end
    }

    fn signal_patience(&self) -> Duration {
        FAR_SIGNAL_PATIENCE
    }

    fn look_around(&mut self) -> Result<(), Error> {
        Parent::check(&self.parent)?;
        self.abandoned.check(self.membership, self.tick)
    }
}

impl Controlled for StandIn<'_> {
    fn schema(&self) -> u64 {
        self.schema
    }

    fn tick(&self) -> u64 {
        self.tick
    }

    fn info(&self) -> ProcessInfo {
        let info = ProcessInfo::new(Role::Runner, &self.identity);
        ProcessInfo { agents: self.seats, ..info }
    }

    fn counters_mut(&mut self) -> &mut Counters {
        &mut self.counters
    }

    fn obey(&mut self, command: Command, request: &ControlReq) -> ControlStatus {
        match command {
            Command::ShutDown if is_named(request) => {
                self.is_told_to_end = true;
                ControlStatus::Done
            }
            // The other end has a bundle of its own, which nobody here can open.
            Command::PrepareBundle => ControlStatus::NotSupported,
            _ => ControlStatus::NotMine,
        }
    }
}

/// The link of a relay, which passes frames on and keeps none: of the newest it is told here what it is.
struct Overheard<'a> {
    link: &'a mut IoxAgent,
    newest: Option<FrameHeader>,
}

impl FrameRx for Overheard<'_> {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        let Self { link, newest } = self;
        link.receive_frames(&mut |frame| {
            *newest = Some(*frame.header);
            accept(frame)
        })
    }

    fn frame(&self) -> Option<Frame<'_>> {
        self.link.frame()
    }
}

impl AllocRx for Overheard<'_> {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        self.link.receive_allocations(take)
    }
}

impl ActionTx for Overheard<'_> {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.link.send_action(action)
    }
}

impl StatTx for Overheard<'_> {
    fn send_status(&mut self, status: &StatMsg) -> Result<(), LinkError> {
        self.link.send_status(status)
    }
}

impl Bell for Overheard<'_> {
    fn token(&self) -> u32 {
        self.link.token()
    }

    fn wait_until(&mut self, token: u32, until_ns: u64) -> Wake {
        self.link.wait_until(token, until_ns)
    }

    fn ring(&mut self, role: Role) -> Result<(), LinkError> {
        self.link.ring(role)
    }
}

impl Clock for Overheard<'_> {
    fn now_ns(&self) -> u64 {
        self.link.now_ns()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_other_than_the_teams_own_is_named() {
        let wanted = Offer { abi: 3, contract: 7, model: [1; 16], agents: 0b1100 };
        assert_eq!(check(&wanted, &wanted), Ok(()));
        for (offer, words) in [
            (Offer { abi: 2, ..wanted }, "the ABI of messages is 3 here, 2 there"),
            (
                Offer { contract: 8, ..wanted },
                "the contract is 0000000000000007 here, 0000000000000008 there",
            ),
            (Offer { model: [2; 16], ..wanted }, "the bundle is 01010101 here, 02020202 there"),
            (Offer { agents: 0b10, ..wanted }, "the set of agents is 2,3 here, 1 there"),
        ] {
            assert_eq!(check(&offer, &wanted), Err(words.to_string()));
        }
        assert_eq!((host_of(0b1100), host_of(1)), (3, 1));
    }
}
