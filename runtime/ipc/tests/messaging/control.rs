//! Processes that are told what to do, and what they tell of themselves.

use std::collections::{BTreeMap, BTreeSet};
use std::process::{Child, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use sortie_core::link::StatRx;
use sortie_core::roles::{TickReport, WorldObserver};
use sortie_core::wire::{AllocMsg, Command, ControlReq, ControlStatus, Role, StatMsg};
use sortie_ipc::{
    Answer, BellKind, Children, Domain, Error, IoxControl, IoxWatcher, LinkSetup, Order, Stop,
    WorldSettings, control, world_process,
};

use crate::processes::{IMPATIENT, child, running, running_world};
use crate::toy::{self, ToyWorld, Watchdog};

fn tell(domain: &Domain, command: Command) -> Vec<Answer> {
    control(domain, &Order::new(command)).unwrap()
}

fn of_role(answers: &[Answer], role: Role) -> Vec<&Answer> {
    answers.iter().filter(|answer| answer.process.role == role).collect()
}

/// Asks until the answers are as expected.
fn await_info(domain: &Domain, is_expected: impl Fn(&[Answer]) -> bool) -> Vec<Answer> {
    loop {
        let answers = tell(domain, Command::Info);
        if is_expected(&answers) {
            return answers;
        }
        std::thread::yield_now();
    }
}

fn end(domain: &Domain, mut world: Child) {
    let told = tell(domain, Command::ShutDown);
    assert_eq!(told.len(), 1, "{told:?}");
    assert_eq!(world.wait().unwrap().code(), Some(0));
    assert_eq!(toy::leftovers(domain), [""; 0]);
}

#[test]
fn a_world_is_paused_continued_reset_and_ended() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let world = running_world(&domain);
    let all = await_info(&domain, |answers| answers.len() == 4);
    assert!(all.iter().all(|answer| answer.status == Some(ControlStatus::Done)));
    assert!(all.iter().all(|answer| answer.tick > 1 << 32), "{all:?}");
    let seats = of_role(&all, Role::Runner).iter().fold(0, |all, one| all | one.process.agents);
    let (worlds, leaders) = (of_role(&all, Role::World), of_role(&all, Role::Allocator));
    assert_eq!((seats, worlds[0].process.agents), (0b111, 0b111));
    assert_eq!((worlds[0].process.pid, leaders[0].process.term), (world.id(), Some(1)));
    let told = tell(&domain, Command::Pause);
    assert_eq!(told.len(), 1);
    assert_eq!(told[0].process.pid, world.id());
    // The current tick is played; then the world stands still, and says so.
    let mut before = 0;
    let paused = loop {
        let now = of_role(&tell(&domain, Command::Info), Role::World)[0].to_owned();
        if std::mem::replace(&mut before, now.tick) == now.tick {
            break now;
        }
    };
    assert!(paused.process.is_paused);
    assert_eq!(tell(&domain, Command::Resume)[0].status, Some(ControlStatus::Done));
    await_info(&domain, |answers| of_role(answers, Role::World)[0].tick > paused.tick + 10);
    assert_eq!(tell(&domain, Command::ResetEpisode)[0].status, Some(ControlStatus::Done));
    end(&domain, world);
}

#[test]
fn one_process_is_meant_or_all_whom_it_concerns() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let world = running_world(&domain);
    let all = await_info(&domain, |answers| answers.len() == 4);
    let runner = of_role(&all, Role::Runner)[1].process.pid;
    let order = |command, number| Order { process: Some(runner), number, ..Order::new(command) };
    let outcome = |order: &Order| {
        let told = control(&domain, order).unwrap();
        told.iter().map(|answer| (answer.process.pid, answer.status)).collect::<Vec<_>>()
    };
    let said = |status| vec![(runner, Some(status))];
    assert_eq!(outcome(&order(Command::Info, 0)), said(ControlStatus::Done));
    assert_eq!(outcome(&order(Command::SetLogLevel, 4)), said(ControlStatus::Done));
    assert_eq!(outcome(&order(Command::SetLogLevel, 9)), said(ControlStatus::BadArgument));
    assert_eq!(outcome(&order(Command::PrepareBundle, 0)), said(ControlStatus::NotSupported));
    // Only a leader can step down.
    assert_eq!(outcome(&order(Command::StepDown, 0)), []);
    // A world notes what comes next, runners and the allocator open it.
    assert_eq!(tell(&domain, Command::PrepareBundle).len(), 4);
    let quieter = Order { number: 5, ..Order::new(Command::SetLogLevel) };
    assert_eq!(control(&domain, &quieter).unwrap().len(), 4);
    end(&domain, world);
    let nobody = control(&domain, &Order::new(Command::Info)).unwrap_err();
    assert_eq!(nobody.exit_code(), 69);
}

/// A team without its world, which was killed.
fn orphans<const N: usize>(domain: &Domain, roles: [&str; N]) -> [Child; N] {
    let mut world = child(domain, "world without team").stdout(Stdio::piped()).spawn().unwrap();
    let team = roles.map(|role| child(domain, role).spawn().unwrap());
    world = running(world);
    await_info(domain, |answers| answers.len() == N + 1);
    world.kill().unwrap();
    world.wait().unwrap();
    team
}

#[test]
fn an_order_to_end_reaches_those_who_have_no_world_any_more() {
    let _watchdog = Watchdog::new();
    for _ in 0..3 {
        let domain = toy::domain();
        let team = orphans(&domain, ["0,2", "1", "allocator", "allocator"]);
        let told = tell(&domain, Command::ShutDown);
        assert_eq!(told.len(), 4, "{told:?}");
        assert!(told.iter().all(|answer| answer.status == Some(ControlStatus::Done)));
        for mut process in team {
            assert_eq!(process.wait().unwrap().code(), Some(0));
        }
        assert_eq!(toy::leftovers(&domain), [""; 0]);
    }
}

#[test]
fn one_process_of_a_team_ends_where_it_is_named() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let [mut first, mut second] = orphans(&domain, ["0,1,2", "allocator"]);
    let named = Order { process: Some(first.id()), ..Order::new(Command::ShutDown) };
    let told = control(&domain, &named).unwrap();
    assert_eq!((told.len(), told[0].status), (1, Some(ControlStatus::Done)));
    assert_eq!(first.wait().unwrap().code(), Some(0));
    assert_eq!(second.try_wait().unwrap(), None);
    assert_eq!(tell(&domain, Command::ShutDown).len(), 1);
    assert_eq!(second.wait().unwrap().code(), Some(0));
}

#[test]
fn who_has_had_no_world_for_too_long_ends() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let impatient = [IMPATIENT.to_owned() + "0,2", IMPATIENT.to_owned() + "allocator"];
    let [runner, allocator, mut patient] = orphans(&domain, [&impatient[0], &impatient[1], "1"]);
    for mut process in [runner, allocator] {
        assert_eq!(process.wait().unwrap().code(), Some(69));
    }
    assert_eq!(patient.try_wait().unwrap(), None);
    assert_eq!(tell(&domain, Command::ShutDown).len(), 1);
    assert_eq!(patient.wait().unwrap().code(), Some(0));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

/// The newest status of each process, as a watcher sees them, until they are as expected.
fn await_statuses(
    watcher: &mut IoxWatcher,
    is_expected: impl Fn(&BTreeMap<u32, StatMsg>) -> bool,
) -> BTreeMap<u32, StatMsg> {
    let mut statuses = BTreeMap::new();
    while !is_expected(&statuses) {
        let mut note = |status: &StatMsg| {
            statuses.insert(status.pid, *status);
        };
        watcher.receive_statuses(&mut note).unwrap();
        std::thread::yield_now();
    }
    statuses
}

#[test]
fn every_role_tells_of_itself_and_counts_requests_of_others() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let world = running_world(&domain);
    let membership = domain.enter().unwrap();
    let facts = membership.facts().unwrap().unwrap();
    let format = facts.format().unwrap();
    let setup = LinkSetup {
        domain: &domain,
        format,
        name: "watcher",
        bell: facts.bell(),
        linger: Duration::ZERO,
    };
    let mut watcher: IoxWatcher = IoxWatcher::open(&setup).unwrap();
    let mut link: IoxControl = IoxControl::open(&setup).unwrap();
    let own = ControlReq { token: 77, ..ControlReq::new(format.schema, Command::Pause) };
    let foreign = [ControlReq { schema: format.schema ^ 1, ..own }, ControlReq { abi: 1, ..own }];
    for request in foreign {
        let answers = link.ask(&request, Duration::from_secs(10)).unwrap();
        assert_eq!(answers.len(), 4);
        let is_refused = |status: i32| status == ControlStatus::Foreign as i32;
        assert!(answers.iter().all(|answer| is_refused(answer.status) && answer.token == 77));
    }
    let unknown = ControlReq { cmd: 99, ..own };
    let answers = link.ask(&unknown, Duration::from_secs(10)).unwrap();
    assert!(answers.iter().all(|answer| answer.status == ControlStatus::NotSupported as i32));
    const SCHEMA_REJECTS: usize = 6;
    let statuses = await_statuses(&mut watcher, |statuses| {
        let counted = statuses.values().filter(|status| status.counters[SCHEMA_REJECTS] == 2);
        counted.count() == 4
    });
    for status in statuses.values() {
        assert!(status.fits(format.schema) && status.t_ns > status.start_ns);
        let is_runner = status.role == Role::Runner as u8;
        assert_eq!(status.has(StatMsg::LEADER), !is_runner, "role {}", status.role);
        assert!(!status.has(StatMsg::DEGRADED) && status.last_tick > 1 << 32);
        // One per frame, but for those that came while it was busy.
        let [wakes, works] =
            [status.hist_wake, status.hist_work].map(|counts| counts.iter().sum::<u32>());
        assert!(works > 0 && wakes > 0, "role {}: {wakes}, {works}", status.role);
        assert!(u64::from(works) <= status.counters[0], "{status:?}");
    }
    assert!(statuses[&world.id()].name.starts_with(b"world\0"));
    drop((link, watcher, membership));
    end(&domain, world);
}

#[test]
fn a_leader_that_steps_down_leaves_the_lead_to_the_standby() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let world = running_world(&domain);
    let mut standby = child(&domain, "allocator").spawn().unwrap();
    let leads = |answers: &[Answer], term| {
        let mut allocators = answers.iter().filter(|one| one.process.role == Role::Allocator);
        allocators.find(|one| one.process.term == Some(term)).map(|one| one.process.pid)
    };
    let all = await_info(&domain, |answers| answers.len() == 5);
    let mut last = leads(&all, 1).unwrap();
    // Whoever stepped down rests before it stands in line again, and leads again after the other.
    for term in 2..5 {
        let told = tell(&domain, Command::StepDown);
        let outcome: Vec<_> = told.iter().map(|one| (one.process.pid, one.status)).collect();
        assert_eq!(outcome, [(last, Some(ControlStatus::Done))]);
        let now = await_info(&domain, |answers| leads(answers, term).is_some());
        let leader = leads(&now, term).unwrap();
        assert_ne!(leader, last);
        assert_eq!(of_role(&now, Role::Allocator).len(), 2);
        last = leader;
    }
    tell(&domain, Command::ShutDown);
    assert!(standby.wait().unwrap().success());
    let mut world = world;
    assert_eq!(world.wait().unwrap().code(), Some(0));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

/// Stops the leading allocator until it has missed more than its chances, and lets it go on.
struct Nap {
    allocators: BTreeSet<u32>,
    leader: Option<Pid>,
    stopped: Option<Pid>,
    continued: bool,
    terms: Vec<u32>,
    leaders: Vec<Pid>,
    enough: Stop,
}

impl WorldObserver for Nap {
    fn status(&mut self, status: &StatMsg) {
        if status.role != Role::Allocator as u8 {
            return;
        }
        self.allocators.insert(status.pid);
        if status.has(StatMsg::LEADER) {
            self.leader = Pid::from_raw(status.pid as i32);
            self.leaders.extend(self.leader);
            self.leaders.dedup();
        }
    }

    fn allocated(&mut self, allocation: &AllocMsg) {
        self.terms.push(allocation.term);
        self.terms.dedup();
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        match (self.leader, self.stopped) {
            (Some(leader), None) if self.allocators.len() == 2 && !self.terms.is_empty() => {
                kill_process(leader, Signal::STOP).unwrap();
                self.stopped = Some(leader);
            }
            (_, Some(stopped)) if report.allocations_missed > 4 && !self.continued => {
                kill_process(stopped, Signal::CONT).unwrap();
                self.continued = true;
            }
            // Statuses of two processes come in any order: the first leader's last may follow the second's first.
            _ if self.terms.len() == 2 && self.leaders.len() >= 2 => self.enough.stop(),
            _ => {}
        }
    }
}

#[test]
fn a_leader_that_does_not_allocate_is_asked_to_step_down() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut team = Children::default();
    for role in ["allocator", "allocator", "0,1,2"] {
        team.spawn(role, &mut child(&domain, role)).unwrap();
    }
    let enough = Stop::new();
    let mut nap = Nap {
        allocators: BTreeSet::new(),
        leader: None,
        stopped: None,
        continued: false,
        terms: Vec::new(),
        leaders: Vec::new(),
        enough: enough.clone(),
    };
    let settings = WorldSettings {
        allocator: true,
        strict: false,
        period: Duration::from_millis(4),
        bell: BellKind::Doorbell,
        ..WorldSettings::default()
    };
    let (contract, start) = (toy::contract(), |_: &mut _| Ok(()));
    let mut world = ToyWorld::new();
    let played = world_process(&domain, &contract, &mut world, &settings, start, &mut nap, &enough);
    assert!(matches!(played, Err(Error::Interrupted)), "{played:?}");
    team.finish(Duration::from_secs(10));
    team.check().unwrap();
    // Nobody died: the first leader let the lock go by itself.
    assert_eq!((nap.terms, nap.leaders.first()), (vec![1, 2], nap.stopped.as_ref()));
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
