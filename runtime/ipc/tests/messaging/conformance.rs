//! What every link must do, once for each: the laws are written against the core's traits alone.

use std::borrow::BorrowMut;
use std::time::Duration;

use sortie_core::link::{
    AgentLink, AllocLink, Direct, DirectAgent, DirectAllocator, DirectCursor, DirectWorld,
    FrameBlock, WorldLink,
};
use sortie_core::wire::{ControlStatus, FrameFormat};
use sortie_ipc::{
    BellKind, ControlRx, Domain, DomainContract, DomainFacts, Housekeeping, InterProcess,
    IntraProcess, IoxAgent, IoxAllocator, IoxWorld, LinkService, LinkSetup, Membership,
    MonotonicClock, ThreadAgent, ThreadAllocator, ThreadWorld, Threads,
};

use crate::toy;

mod over_serial;
mod runner_laws;
mod stage;
mod world_laws;

/// A team's links, opened when they are first used.
pub(crate) trait Transport {
    type WorldLink<'a>: WorldLink
    where
        Self: 'a;
    type AgentLink<'a>: AgentLink
    where
        Self: 'a;
    type AllocLink<'a>: AllocLink
    where
        Self: 'a;

    fn new() -> Self;
    fn format(&self) -> FrameFormat;
    fn world(&mut self) -> impl BorrowMut<Self::WorldLink<'_>>;
    /// The link of the runner `index`, below 3.
    fn agent(&mut self, index: usize) -> impl BorrowMut<Self::AgentLink<'_>>;
    /// The link of the allocator `index`, below 2.
    fn allocator(&mut self, index: usize) -> impl BorrowMut<Self::AllocLink<'_>>;
    /// Does for all links what is due once per heartbeat.
    fn housekeep(&mut self);
}

fn format_of(contract: &DomainContract) -> FrameFormat {
    DomainFacts::new(contract, toy::SHAPE).format().unwrap()
}

struct OneThread {
    team: Direct<'static>,
    format: FrameFormat,
    world: DirectCursor,
    agents: [DirectCursor; 3],
    allocators: [DirectCursor; 2],
}

impl Transport for OneThread {
    type WorldLink<'a> = DirectWorld<'a, 'static>;
    type AgentLink<'a> = DirectAgent<'a, 'static>;
    type AllocLink<'a> = DirectAllocator<'a, 'static>;

    fn new() -> Self {
        let format = format_of(&toy::contract());
        let blocks = format.layout.payload_bytes() / 64;
        let memory = vec![FrameBlock::zeroed(); blocks].leak();
        Self {
            team: Direct::new(memory, &MonotonicClock),
            format,
            world: DirectCursor::default(),
            agents: [DirectCursor::default(); 3],
            allocators: [DirectCursor::default(); 2],
        }
    }

    fn format(&self) -> FrameFormat {
        self.format
    }

    fn world(&mut self) -> impl BorrowMut<Self::WorldLink<'_>> {
        self.team.world(&mut self.world)
    }

    fn agent(&mut self, index: usize) -> impl BorrowMut<Self::AgentLink<'_>> {
        self.team.agent(&mut self.agents[index])
    }

    fn allocator(&mut self, index: usize) -> impl BorrowMut<Self::AllocLink<'_>> {
        self.team.allocator(&mut self.allocators[index])
    }

    fn housekeep(&mut self) {}
}

/// Links over a service of iceoryx2, woken by one kind of bell.
trait Service {
    type Kind: LinkService;
    const BELL: BellKind;
}

struct SharedMemory;
impl Service for SharedMemory {
    type Kind = InterProcess;
    const BELL: BellKind = BellKind::Doorbell;
}

struct SharedMemoryEvents;
impl Service for SharedMemoryEvents {
    type Kind = InterProcess;
    const BELL: BellKind = BellKind::Event;
}

struct OneProcess;
impl Service for OneProcess {
    type Kind = IntraProcess;
    const BELL: BellKind = BellKind::Event;
}

struct Iox<S: Service> {
    world: Option<IoxWorld<S::Kind>>,
    agents: [Option<IoxAgent<S::Kind>>; 3],
    allocators: [Option<IoxAllocator<S::Kind>>; 2],
    format: FrameFormat,
    membership: Membership,
}

fn setup<'a>(domain: &'a Domain, format: FrameFormat, name: &'a str) -> LinkSetup<'a> {
    LinkSetup { domain, format, name, bell: BellKind::Doorbell, linger: Duration::ZERO }
}

impl<S: Service> Iox<S> {
    fn setup<'a>(domain: &'a Domain, format: FrameFormat, name: &'a str) -> LinkSetup<'a> {
        LinkSetup { bell: S::BELL, ..setup(domain, format, name) }
    }
}

impl<S: Service + 'static> Transport for Iox<S> {
    type WorldLink<'a> = IoxWorld<S::Kind>;
    type AgentLink<'a> = IoxAgent<S::Kind>;
    type AllocLink<'a> = IoxAllocator<S::Kind>;

    fn new() -> Self {
        Self {
            world: None,
            agents: [None, None, None],
            allocators: [None, None],
            format: format_of(&toy::contract()),
            membership: toy::domain().enter().unwrap(),
        }
    }

    fn format(&self) -> FrameFormat {
        self.format
    }

    fn world(&mut self) -> impl BorrowMut<Self::WorldLink<'_>> {
        let setup = Self::setup(self.membership.domain(), self.format, "world");
        self.world.get_or_insert_with(|| IoxWorld::open(&setup).unwrap())
    }

    fn agent(&mut self, index: usize) -> impl BorrowMut<Self::AgentLink<'_>> {
        let setup = Self::setup(self.membership.domain(), self.format, "agent");
        self.agents[index].get_or_insert_with(|| IoxAgent::open(&setup).unwrap())
    }

    fn allocator(&mut self, index: usize) -> impl BorrowMut<Self::AllocLink<'_>> {
        let setup = Self::setup(self.membership.domain(), self.format, "allocator");
        self.allocators[index].get_or_insert_with(|| IoxAllocator::open(&setup).unwrap())
    }

    fn housekeep(&mut self) {
        self.world.iter_mut().for_each(Housekeeping::housekeep);
        self.agents.iter_mut().flatten().for_each(Housekeeping::housekeep);
        self.allocators.iter_mut().flatten().for_each(Housekeeping::housekeep);
    }
}

struct InThreads {
    team: Threads,
    format: FrameFormat,
    world: ThreadWorld,
    agents: [Option<ThreadAgent>; 3],
    allocators: [ThreadAllocator; 2],
}

impl Transport for InThreads {
    type WorldLink<'a> = ThreadWorld;
    type AgentLink<'a> = ThreadAgent;
    type AllocLink<'a> = ThreadAllocator;

    fn new() -> Self {
        let format = format_of(&toy::contract());
        let team = Threads::new(&format);
        let allocators = [team.allocator(), team.allocator()];
        Self { world: team.world(), agents: [None, None, None], allocators, format, team }
    }

    fn format(&self) -> FrameFormat {
        self.format
    }

    fn world(&mut self) -> impl BorrowMut<Self::WorldLink<'_>> {
        &mut self.world
    }

    fn agent(&mut self, index: usize) -> impl BorrowMut<Self::AgentLink<'_>> {
        self.agents[index].get_or_insert_with(|| self.team.agent())
    }

    fn allocator(&mut self, index: usize) -> impl BorrowMut<Self::AllocLink<'_>> {
        &mut self.allocators[index]
    }

    fn housekeep(&mut self) {}
}

macro_rules! every_link_obeys {
    ($($subject:ident: $($law:ident),+;)+) => {
        mod one_thread {
            $($(#[test]
            fn $law() {
                super::$subject::$law::<super::OneThread>();
            })+)+
        }

        mod in_threads {
            $($(#[test]
            fn $law() {
                super::$subject::$law::<super::InThreads>();
            })+)+
        }

        mod over_serial_lines {
            $($(#[test]
            fn $law() {
                super::$subject::$law::<super::over_serial::OverSerial>();
            })+)+
        }

        every_link_obeys! { shared_memory, SharedMemory; $($subject: $($law),+;)+ }
        every_link_obeys! { shared_memory_events, SharedMemoryEvents; $($subject: $($law),+;)+ }
        every_link_obeys! { one_process, OneProcess; $($subject: $($law),+;)+ }
    };
    ($module:ident, $service:ident; $($subject:ident: $($law:ident),+;)+) => {
        mod $module {
            $($(#[test]
            fn $law() {
                let _watchdog = crate::toy::Watchdog::new();
                super::$subject::$law::<super::Iox<super::$service>>();
            })+)+
        }
    };
}

every_link_obeys! {
    runner_laws:
        the_newest_frame_wins_and_gaps_are_counted,
        a_late_joiner_gets_the_allocation,
        frames_of_an_earlier_world_are_dropped,
        allocations_are_ordered_by_term_and_epoch,
        an_allocation_of_another_shape_is_dropped,
        a_fresh_allocation_is_acted_on,
        a_stale_allocation_is_kept_for_its_grace,
        an_allocation_of_an_earlier_episode_counts_as_none,
        agents_wait_for_the_allocation_until_its_deadline,
        a_policy_that_refuses_falls_back,
        absent_agents_do_not_act,
        a_pausing_world_asks_for_nothing,
        warm_up_frames_are_decided_on_once_and_not_answered;
    world_laws:
        foreign_messages_are_dropped,
        the_world_waits_for_its_seats_and_names_who_is_missing,
        a_seat_that_does_not_act_is_named,
        an_allocator_that_does_not_allocate_is_named,
        a_goodbye_frees_the_seat,
        the_goodbye_of_an_earlier_holder_frees_nothing,
        nobody_acts_for_a_free_seat_but_the_fallback,
        a_silent_agent_is_left_out_of_allocations_until_it_acts_again,
        late_and_impossible_actions_are_counted_not_applied,
        shutting_down_ends_everyone;
}

#[test]
fn the_dead_leave_nothing_though_they_were_told_to_step_down() {
    let membership = toy::domain().enter().unwrap();
    let (domain, format) = (membership.domain(), format_of(&toy::contract()));
    let mut world: IoxWorld = IoxWorld::open(&setup(domain, format, "world")).unwrap();
    let objects = |world: &mut IoxWorld| {
        (0..3).for_each(|_| world.housekeep());
        domain.shared_memory().unwrap().len()
    };
    let alone = objects(&mut world);
    for pid in 1..4 {
        let setup = setup(domain, format, "allocator");
        let mut allocator: IoxAllocator = IoxAllocator::open(&setup).unwrap();
        world.housekeep();
        world.ask_to_step_down(pid).unwrap();
        let asked = allocator.answer_requests(&mut |request| {
            assert_eq!(request.arg, pid);
            request.answer(format.schema, ControlStatus::Done, 0)
        });
        assert!(asked && objects(&mut world) > alone);
        drop(allocator);
        assert_eq!(objects(&mut world), alone, "after {pid}");
    }
}

#[test]
fn a_link_of_another_schema_is_refused() {
    let membership = toy::domain().enter().unwrap();
    let format = format_of(&toy::contract());
    let _world: IoxWorld = IoxWorld::open(&setup(membership.domain(), format, "world")).unwrap();
    let other = FrameFormat { schema: format.schema + 1, ..format };
    let setup = setup(membership.domain(), other, "agent");
    let refused = IoxAgent::<InterProcess>::open(&setup).err().unwrap();
    assert!(refused.to_string().contains("runs another schema"), "{refused}");
    assert_eq!(refused.exit_code(), 78);
}
