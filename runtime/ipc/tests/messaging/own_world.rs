//! The example of a world of one's own: its program, and a runner that acts in it.

use std::process::Command;
use std::time::Duration;

use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_ipc::{Children, Domain, ProcessSettings, Stop, runner_process};

use crate::processes::child;
use crate::toy::{self, Watchdog};

#[path = "../../../../examples/own_world/src/main.rs"]
mod program;

/// Role of the example's process in the environment, and of its runner's.
pub(crate) const WORLD: &str = "own world";
pub(crate) const RUNNER: &str = "runner of the own world";

/// What the process of a role does.
pub(crate) fn play(role: &str, domain: &Domain) -> Result<(), Box<dyn std::error::Error>> {
    if role == WORLD {
        return program::main();
    }
    let settings = ProcessSettings::default();
    let stop = Stop::on_signals()?;
    runner_process(domain, &program::contract(), &[0, 1], &mut GoOn, &settings, &stop)?;
    Ok(())
}

/// Goes on wherever it can.
struct GoOn;

impl Policy for GoOn {
    fn actions(&self) -> usize {
        2
    }

    fn utilities(&mut self, _: &Observation<'_>, utilities: &mut [f32]) -> Result<(), DecideError> {
        utilities.copy_from_slice(&[0.0, 1.0]);
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let goes_on = observation.available.get(1).is_some_and(|code| *code != 0);
        Ok(Decision { action: u16::from(goes_on), utility: 0.0 })
    }
}

#[test]
fn a_runner_acts_in_a_world_of_ones_own() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut runner = Children::default();
    runner.spawn(RUNNER, &mut child(&domain, RUNNER)).unwrap();
    let mut world: Command = child(&domain, WORLD);
    let told = world.env("SORTIE_DOMAIN", domain.id()).stdout(std::process::Stdio::piped());
    let told = told.output().unwrap();
    assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
    assert!(String::from_utf8_lossy(&told.stdout).contains("9 ticks"));
    runner.finish(Duration::from_secs(10));
    runner.check().unwrap();
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
