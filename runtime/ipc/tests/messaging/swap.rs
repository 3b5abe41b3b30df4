//! Teams that change their bundle while they run: all at one tick, or none.

use std::process::Child;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use sortie_core::roles::{Counters, TickReport, WorldObserver};
use sortie_core::wire::{Command, ControlStatus, Role, SwapMoment, TurnBack};
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_ipc::{
    AllocatorProcess, Children, Domain, DomainContract, Error, LoadedModel, Order, ProcessInfo,
    ProcessSettings, Readiness, Registry, RunnerProcess, Stop, Swap, SwappedAllocator,
    SwappedPolicy, WorldSettings, control, world_process,
};

use crate::processes::{child, settings};
use crate::toy::{self, SHAPE, ToyAllocator, ToyWorld, Watchdog};

/// The role of a child with a registry, before `allocator`, `world` or its agents.
pub(crate) const SWAPS: &str = "swaps ";
/// The model that children start with; models are called by their first byte.
const FIRST: u8 = 1;
/// The model that refuses every observation.
const REFUSES: u8 = 7;

/// Of bundle `1`, whose id is all ones.
fn contract() -> DomainContract {
    DomainContract { bundle: Some(FIRST.to_string()), model: [FIRST; 16], ..toy::contract() }
}

/// Models by their number, `foreign` of another contract, and `small`.
fn load<M>(model: impl Fn(u8) -> M, name: &str) -> Result<LoadedModel<M>, ControlStatus> {
    let number = match name {
        "foreign" | "small" => 9,
        other => other.parse().map_err(|_| ControlStatus::BadArgument)?,
    };
    Ok(LoadedModel {
        contract: contract().hash ^ u64::from(name == "foreign"),
        id: [number; 16],
        entities_max: if name == "small" { 1 } else { SHAPE.entities },
        tasks_max: SHAPE.tasks,
        model: model(number),
    })
}

/// Takes the safe action, and says by its utility which model it is.
struct Numbered(u8);

impl Policy for Numbered {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
        Err(DecideError::BadLength)
    }

    fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
        match self.0 {
            REFUSES => Err(DecideError::NonFinite),
            number => Ok(Decision { action: 1, utility: number.into() }),
        }
    }
}

/// What a child does.
pub(crate) fn act(
    role: &str,
    domain: &Domain,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<Counters, Error> {
    let settings = ProcessSettings { model: [FIRST; 16], ..*settings };
    match role.trim_start_matches(SWAPS) {
        "world" => {
            let start = |_: &mut Children| Ok(());
            let (mut world, settings) = (ToyWorld::new(), patient());
            world_process(domain, &started_as(domain), &mut world, &settings, start, &mut (), stop)
        }
        "allocator" => {
            let open = |name: &str| load(|_| Box::new(ToyAllocator) as SwappedAllocator, name);
            let mut process = AllocatorProcess::join(domain, &started_as(domain), &settings, stop)?;
            let ended = process.allocate(&mut ToyAllocator, Some(Registry::start(open)?), stop);
            let left = process.leave();
            ended.and(left)
        }
        agents => {
            let agents: Vec<u16> = agents.split(',').map(|agent| agent.parse().unwrap()).collect();
            let open =
                |name: &str| load(|number| Box::new(Numbered(number)) as SwappedPolicy, name);
            let contract = started_as(domain);
            let settings = ProcessSettings { model: contract.model, ..settings };
            let mut policy = Numbered(contract.model[0]);
            let mut process = RunnerProcess::join(domain, &contract, &agents, &settings, stop)?;
            let ended = process.act(&mut policy, None, Some(Registry::start(open)?), stop);
            let left = process.leave();
            ended.and(left)
        }
    }
}

/// The bundle that the team decides by, as a process that is started again finds it.
fn started_as(domain: &Domain) -> DomainContract {
    let facts = domain.facts().unwrap();
    let name = facts.map_or(FIRST.to_string(), |facts| facts.bundles().in_use().name.clone());
    DomainContract { model: [name.parse().unwrap(); 16], ..contract() }
}

fn patient() -> WorldSettings {
    WorldSettings {
        episodes: None,
        strict: false,
        tick_interval: Duration::from_millis(1),
        patience: Duration::from_millis(200),
        ..settings(0)
    }
}

/// The models of a tick's answers, and whether one of them is a fallback.
type Tick = (Vec<u8>, bool);

/// Notes by which models a team decided, and sees that nobody decides by two at once.
#[derive(Clone, Default)]
struct Watch(Arc<Mutex<Vec<Tick>>>);

impl WorldObserver for Watch {
    fn tick(&mut self, report: &TickReport<'_>) {
        let model = |answer: &sortie_core::wire::ActionMsg| answer.model.to_le_bytes()[0];
        let decided = report.answers().filter(|answer| answer.q != 0.0);
        let models: Vec<u8> = decided
            .map(|answer| {
                assert_eq!(answer.q, f32::from(model(answer)));
                model(answer)
            })
            .collect();
        assert!(models.windows(2).all(|pair| pair[0] == pair[1]), "{models:?}");
        let fallback = sortie_core::wire::ActionMsg::FALLBACK;
        let has_fallen_back = report.answers().any(|answer| answer.has(fallback));
        self.0.lock().unwrap().push((models, has_fallen_back));
    }
}

impl Watch {
    fn ticks(&self) -> usize {
        self.0.lock().unwrap().len()
    }

    /// Waits until the team decides by this model.
    fn await_model(&self, model: u8) {
        let is_so = |tick: &Tick| tick.0.first() == Some(&model);
        await_that(|| self.0.lock().unwrap().last().is_some_and(is_so));
    }
}

fn await_that(mut is_so: impl FnMut() -> bool) {
    while !is_so() {
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Waits until all have opened what they were told to, or one has refused.
fn readiness(swap: &Swap) -> Readiness {
    loop {
        let found = swap.readiness().unwrap();
        if found != Readiness::Opening {
            return found;
        }
    }
}

fn begin(domain: &Domain, name: &str, model: u8) -> Swap {
    Swap::begin(domain, name, [model; 16]).unwrap().unwrap()
}

/// Changes at the next tick, and waits for it.
fn change_to(domain: &Domain, model: u8, watch: &Watch, back: TurnBack) {
    let swap = begin(domain, &model.to_string(), model);
    assert_eq!(readiness(&swap), Readiness::Ready);
    swap.change(SwapMoment::NextTick, back, 1_000).unwrap().unwrap();
    if !back.on_fallback {
        watch.await_model(model);
    }
}

fn processes(domain: &Domain) -> Vec<ProcessInfo> {
    let answers = control(domain, &Order::new(Command::Info)).unwrap();
    answers.into_iter().map(|answer| answer.process).collect()
}

/// Ends the world however its driver ends.
struct AtEnd(Stop);

impl Drop for AtEnd {
    fn drop(&mut self) {
        self.0.stop();
    }
}

/// Plays the toy world in this process while `drive` changes its bundles in another thread.
fn with_team(roles: &[&str], drive: impl FnOnce(&Domain, &Watch) + Send) {
    let _watchdog = Watchdog::new();
    let (domain, stop, watch) = (toy::domain(), Stop::new(), Watch::default());
    let start = |children: &mut Children| {
        roles.iter().try_for_each(|role| children.spawn(*role, &mut child(&domain, role)))
    };
    let played = std::thread::scope(|scope| {
        let driving = scope.spawn(|| {
            let _ending = AtEnd(stop.clone());
            await_that(|| watch.ticks() > 0);
            drive(&domain, &watch);
        });
        let (contract, mut world, mut seen) = (contract(), ToyWorld::new(), watch.clone());
        let settings = patient();
        let played =
            world_process(&domain, &contract, &mut world, &settings, start, &mut seen, &stop);
        driving.join().unwrap();
        played
    });
    assert!(matches!(played, Err(Error::Interrupted)), "{played:?}");
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}

const TEAM: [&str; 3] = ["swaps allocator", "swaps 0,2", "swaps 1"];

#[test]
fn a_team_changes_its_bundle_at_one_tick_and_keeps_it_where_another_does_not_fit() {
    with_team(&TEAM, |domain, watch| {
        change_to(domain, 2, watch, TurnBack::default());
        let refusals = [
            ("none", ControlStatus::BadArgument),
            ("foreign", ControlStatus::Foreign),
            ("small", ControlStatus::Foreign),
        ];
        for (name, status) in refusals {
            let swap = begin(domain, name, 9);
            let Readiness::Refused(by) = readiness(&swap) else { panic!("{name} is taken") };
            assert!(by.iter().all(|(_, why)| *why == status), "{name}: {by:?}");
        }
        watch.await_model(2);
        change_to(domain, 3, watch, TurnBack::default());
        let all = processes(domain);
        assert!(all.iter().all(|process| process.generation == 2), "{all:?}");
        let decide = |process: &&ProcessInfo| process.role != Role::World;
        assert!(all.iter().filter(decide).all(|process| process.model == [3; 16]), "{all:?}");
    });
}

#[test]
fn a_change_waits_for_its_episode_and_nothing_comes_between() {
    with_team(&TEAM, |domain, watch| {
        let swap = begin(domain, "2", 2);
        assert_eq!(readiness(&swap), Readiness::Ready);
        // Another one is refused by name as long as this one is under way.
        let other = Swap::begin(domain, "3", [3; 16]);
        assert!(matches!(other, Err(Error::Busy { .. })), "{other:?}");
        let before = watch.ticks();
        swap.change(SwapMoment::NextEpisode, TurnBack::default(), 0).unwrap().unwrap();
        let again = swap.change(SwapMoment::NextTick, TurnBack::default(), 0).unwrap();
        assert_eq!(again.unwrap_err()[0].status, Some(ControlStatus::Outdated));
        watch.await_model(2);
        let ticks = watch.0.lock().unwrap();
        let first = ticks.iter().position(|(models, _)| models.first() == Some(&2)).unwrap();
        assert!(first >= before && first.is_multiple_of(toy::EPISODE as usize), "{first}");
    });
}

#[test]
fn a_team_turns_back_in_one_tick_where_its_new_policy_refuses() {
    with_team(&TEAM, |domain, watch| {
        let on_fallback = TurnBack { on_fallback: true, ..TurnBack::default() };
        change_to(domain, REFUSES, watch, on_fallback);
        await_that(|| watch.0.lock().unwrap().iter().any(|(_, has_fallen_back)| *has_fallen_back));
        watch.await_model(FIRST);
        let ticks = watch.0.lock().unwrap();
        let fallen = ticks.iter().filter(|(_, has_fallen_back)| *has_fallen_back).count();
        assert_eq!(fallen, 1);
        drop(ticks);
        await_that(|| processes(domain).iter().all(|process| process.generation == 2));
        // What made it turn back is forgotten: the next change is an ordinary one.
        change_to(domain, 4, watch, TurnBack::default());
    });
}

/// A child that the test starts again whenever it has killed it.
struct Restarted<'a> {
    domain: &'a Domain,
    role: &'static str,
    child: Child,
}

impl<'a> Restarted<'a> {
    fn start(domain: &'a Domain, role: &'static str) -> Self {
        Self { domain, role, child: child(domain, role).spawn().unwrap() }
    }

    fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        self.child = child(self.domain, self.role).spawn().unwrap();
    }
}

#[test]
fn whoever_is_killed_in_the_midst_of_a_change_comes_back_with_the_bundle_of_its_team() {
    const CHANGES: u64 = 12;
    with_team(&["swaps 1"], |domain, watch| {
        let mut team = ["swaps allocator", "swaps 0,2"].map(|role| Restarted::start(domain, role));
        await_that(|| processes(domain).len() == 4);
        let mut model = FIRST;
        for change in 0..CHANGES {
            let next = 2 + (change % 5) as u8;
            let swap = begin(domain, &next.to_string(), next);
            let victim = &mut team[(change % 2) as usize];
            // Before it has opened the bundle, when it has, or when all have changed.
            match change % 3 {
                0 => victim.kill(),
                1 => {
                    assert_eq!(readiness(&swap), Readiness::Ready);
                    victim.kill();
                }
                _ => {}
            }
            assert_eq!(readiness(&swap), Readiness::Ready);
            swap.change(SwapMoment::NextTick, TurnBack::default(), 0).unwrap().unwrap();
            if change % 3 == 2 {
                victim.kill();
            }
            model = next;
            watch.await_model(model);
            await_that(|| {
                let all = processes(domain);
                let decide = all.iter().filter(|process| process.role != Role::World);
                let has_changed = |process: &ProcessInfo| process.model == [model; 16];
                all.len() == 4 && decide.into_iter().all(has_changed)
            });
        }
        assert_eq!(started_as(domain).model, [model; 16]);
        for Restarted { child, .. } in &mut team {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    });
}

#[test]
fn the_next_world_goes_on_with_the_bundle_that_its_team_has_changed_to() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut all = ["swaps world", "swaps allocator", "swaps 0,1,2"]
        .map(|role| child(&domain, role).spawn().unwrap());
    await_that(|| {
        domain.is_alive().unwrap()
            && control(&domain, &Order::new(Command::Info)).is_ok_and(|all| all.len() == 3)
    });
    let swap = begin(&domain, "5", 5);
    assert_eq!(readiness(&swap), Readiness::Ready);
    swap.change(SwapMoment::NextTick, TurnBack::default(), 0).unwrap().unwrap();
    drop(swap);
    all[0].kill().unwrap();
    all[0].wait().unwrap();
    all[0] = child(&domain, "swaps world").spawn().unwrap();
    let has_changed = |process: &ProcessInfo| {
        process.generation == 1 && (process.role == Role::World || process.model == [5; 16])
    };
    await_that(|| {
        let found = processes(&domain);
        found.len() == 3 && found.iter().all(has_changed)
    });
    control(&domain, &Order::new(Command::ShutDown)).unwrap();
    for child in &mut all {
        child.wait().unwrap();
    }
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
