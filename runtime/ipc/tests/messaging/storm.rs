//! Storms, in short: the long ones are a command.

use std::process::{Command, Stdio};

use sortie_ipc::storm::{StormSettings, raise_storm, storm_process};
use sortie_ipc::{Domain, Stop};

use crate::toy::{self, Watchdog};

const ROLE: &str = "SORTIE_TEST_STORM";
const DOMAIN: &str = "SORTIE_TEST_DOMAIN";

/// Not a test of its own: what the processes of a storm do.
#[test]
fn child_process() {
    let Ok(role) = std::env::var(ROLE) else { return };
    let domain = Domain::new(&std::env::var(DOMAIN).unwrap()).unwrap();
    if let Err(error) = storm_process(&domain, &role, &Stop::on_signals().unwrap()) {
        std::process::exit(error.exit_code().into());
    }
}

#[test]
fn nothing_is_torn_wrong_or_leaked_in_a_storm() {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let child = |role: &str| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args(["storm::child_process", "--exact", "--nocapture"])
            .env(ROLE, role)
            .env(DOMAIN, domain.id())
            .stdout(Stdio::null());
        command
    };
    let settings = StormSettings { runner_kills: 40, allocator_kills: 10, ..Default::default() };
    let report = raise_storm(&domain, &settings, &child, &Stop::new()).unwrap();
    assert_eq!((report.rejoin_ns.len(), report.takeover_ns.len()), (40, 10));
    assert!(report.ticks_with_fallback > 0, "{report:?}");
    let faults = [
        report.torn_frames,
        report.wrong_assignments,
        report.old_terms,
        report.leaked,
        report.left_behind,
    ];
    assert_eq!(faults, [0; 5], "{report:?}");
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
