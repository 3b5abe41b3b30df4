//! A world that acts itself for agents without a process.

use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use sortie_core::roles::{TickReport, WorldObserver};
use sortie_ipc::{Children, Domain, Error, Fill, Stop, WorldSettings, world_process_with_fill};

use crate::processes::{child, run_in_one_thread, settings};
use crate::toy::{self, DecisionLog, ToyPolicy, ToyWorld, Watchdog};

const MODEL: [u8; 16] = [7; 16];

fn play(
    domain: &Domain,
    settings: &WorldSettings,
    observer: &mut dyn WorldObserver,
    stop: &Stop,
) -> Result<(), Error> {
    let start =
        |children: &mut Children| children.spawn("allocator", &mut child(domain, "allocator"));
    let (mut world, contract) = (ToyWorld::new(), toy::contract());
    let fill = Fill { policy: &mut ToyPolicy, model: MODEL, registry: None };
    let filled: (&mut dyn sortie_core::World, _) = (&mut world, fill);
    let played =
        world_process_with_fill(domain, &contract, filled, settings, start, observer, stop);
    assert_eq!(toy::leftovers(domain), [""; 0]);
    played.map(drop)
}

#[test]
fn a_world_that_fills_all_seats_decides_as_a_team_of_one_thread() {
    let _watchdog = Watchdog::new();
    let alone = run_in_one_thread(40);
    for private in [false, true] {
        let (domain, mut log) = (toy::domain(), DecisionLog::default());
        let settings = WorldSettings { private, ..settings(40) };
        play(&domain, &settings, &mut log, &Stop::new()).unwrap();
        toy::assert_same_log(&log, &alone);
    }
}

/// Who acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// The world, for all.
    Fills,
    /// The runner has been started.
    Starts,
    /// The runner acted for all, and was killed.
    Died,
    /// The world again, for all.
    FillsAgain,
}

/// Starts a runner for two agents, kills it once it acts, and waits until the world acts for all again.
struct Relay {
    domain: Domain,
    stage: Stage,
    team: Children,
    unanswered: u32,
    stop: Stop,
}

impl WorldObserver for Relay {
    fn tick(&mut self, report: &TickReport<'_>) {
        let own = std::process::id();
        let answers = || report.answers();
        let present = report.actions.iter().filter(|&&action| action != u16::MAX).count();
        if answers().count() < present {
            // Nobody acts for a seat of the dead until the world takes it for vacant.
            assert_ne!(self.stage, Stage::Fills);
            self.unanswered += u32::from(self.stage == Stage::Died);
        }
        if answers().count() < 3 {
            return;
        }
        let of_world = answers().filter(|answer| answer.runner == own).count();
        assert!(answers().all(|answer| answer.runner != own || answer.model == 0x0707_0707));
        match self.stage {
            Stage::Fills if of_world == 3 => {
                let mut runner = child(&self.domain, "0,2");
                self.team.spawn("the runner", &mut runner).unwrap();
                self.stage = Stage::Starts;
            }
            Stage::Starts if of_world == 1 => {
                let runner = answers().find(|answer| answer.runner != own).unwrap().runner;
                kill_process(Pid::from_raw(runner as i32).unwrap(), Signal::KILL).unwrap();
                self.stage = Stage::Died;
            }
            Stage::Died if of_world == 3 => {
                self.stage = Stage::FillsAgain;
                self.stop.stop();
            }
            _ => {}
        }
    }
}

#[test]
fn a_runner_takes_its_seats_over_and_the_world_takes_them_back() {
    let _watchdog = Watchdog::new();
    let (domain, stop) = (toy::domain(), Stop::new());
    let settings = WorldSettings {
        strict: false,
        episodes: None,
        // In step: who is only slow is waited for, and ticks without an answer are those of the dead.
        patience: Duration::from_millis(500),
        ..settings(0)
    };
    let mut relay = Relay {
        domain: domain.clone(),
        stage: Stage::Fills,
        team: Children::default(),
        unanswered: 0,
        stop: stop.clone(),
    };
    let played = play(&domain, &settings, &mut relay, &stop);
    assert!(matches!(played, Err(Error::Interrupted)), "{played:?}");
    assert_eq!(relay.stage, Stage::FillsAgain);
    // Those of the kill itself, and three for each seat until it is vacant.
    assert!(relay.unanswered <= 8, "{}", relay.unanswered);
}
