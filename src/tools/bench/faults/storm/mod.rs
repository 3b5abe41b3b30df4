//! A storm: a supervised team under load whose processes are killed at random times, again and again,
//! while everything that passes is checked.

mod blows;
mod checks;
mod team;

use std::process::Command;
use std::time::Duration;

use sortie_core::wire::Role;

use self::blows::Blows;
use self::checks::Checks;
use self::team::{StormAllocator, StormPolicy, StormWorld};
use sortie_ipc::Domain;
use sortie_ipc::Error;
use sortie_ipc::Stop;
use sortie_ipc::{Charge, RestartPolicy, supervise};
use sortie_ipc::{
    ProcessSettings, WorldSettings, allocator_process, runner_process, world_process,
};

/// How long and how hard.
#[derive(Clone, Copy, Debug)]
pub(super) struct StormSettings {
    /// Runners to kill.
    pub(super) runner_kills: u32,
    /// Leading allocators to kill.
    pub(super) allocator_kills: u32,
    /// Time from frame to frame.
    pub(super) period: Duration,
    /// Decides who is killed, and when.
    pub(super) seed: u64,
}

impl Default for StormSettings {
    /// A thousand runners and two hundred allocators at 500 Hz.
    fn default() -> Self {
        Self {
            runner_kills: 1_000,
            allocator_kills: 200,
            period: Duration::from_millis(2),
            seed: 1,
        }
    }
}

/// What a storm found. All but the times and the first three numbers are to be 0.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct StormReport {
    /// From the kill of a leading allocator to the first allocation of the next, in nanoseconds, sorted.
    pub(super) takeover_ns: Vec<u64>,
    /// From the kill of a runner to the first action of its successor, in nanoseconds, sorted.
    pub(super) rejoin_ns: Vec<u64>,
    /// Ticks that were played.
    pub(super) ticks: u64,
    /// Ticks in which an agent played the fallback action.
    pub(super) ticks_with_fallback: u64,
    /// Decisions on a frame that was not whole, or not the one answered.
    pub(super) torn_frames: u64,
    /// Subtasks that are not those of the allocation stated, or of the frame that it was made from.
    pub(super) wrong_assignments: u64,
    /// Allocations of an older term or epoch than the same process had acted on.
    pub(super) old_terms: u64,
    /// Objects in shared memory that the dead left behind, while the others live.
    pub(super) leaked: u64,
    /// Objects in shared memory after the end.
    pub(super) left_behind: u64,
}

/// Raises a storm over `domain`, with the world in this process. `child` starts a process that calls
/// [`storm_process`] with the role given.
///
/// # Errors
/// A process fails other than by being killed, or a signal came.
pub(super) fn raise_storm(
    domain: &Domain,
    settings: &StormSettings,
    child: &(dyn Fn(&str) -> Command + Sync),
    stop: &Stop,
) -> Result<StormReport, Error> {
    let over = Stop::new();
    let mut world = StormWorld::default();
    let checks = Checks::new(world.number.clone());
    let mut blows = Blows::new(domain, settings, checks, [stop.clone(), over.clone()]);
    let world_settings = WorldSettings {
        allocator: true,
        strict: false,
        period: settings.period,
        ..WorldSettings::default()
    };
    // Those that are killed are to come back at once.
    let policy = RestartPolicy { immediate: Duration::ZERO, ..RestartPolicy::default() };
    let ended = std::thread::scope(|scope| {
        let (over, world_over) = (over.clone(), blows.stop());
        let supervisor = scope.spawn(move || {
            let ended = supervise(domain, charges(child), &policy, &mut |_| {}, &over);
            world_over.stop();
            ended
        });
        let contract = team::contract();
        let stop = blows.stop();
        let start = |_: &mut _| Ok(());
        let played =
            world_process(domain, &contract, &mut world, &world_settings, start, &mut blows, &stop);
        blows.end();
        let kept = supervisor.join().unwrap_or(Err(Error::Stalled));
        first_failure(played.map(drop), kept.map(drop))
    });
    if !blows.is_done() {
        return Err(ended.err().unwrap_or(Error::Interrupted));
    }
    ended?;
    let left_behind = domain.shared_memory()?.len() as u64;
    Ok(StormReport { left_behind, ..blows.report() })
}

/// What both ended with, where being told to end counts as success.
fn first_failure(played: Result<(), Error>, kept: Result<(), Error>) -> Result<(), Error> {
    for ended in [kept, played] {
        match ended {
            Ok(()) | Err(Error::Interrupted) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Two runners, a leading allocator and a standby.
fn charges(child: &dyn Fn(&str) -> Command) -> Vec<Charge> {
    let charge = |name: &str, role, agents: &[usize]| Charge {
        name: name.to_string(),
        role,
        agents: agents.iter().fold(0, |seats, agent| seats | 1 << agent),
        command: child(name),
    };
    vec![
        charge("runner 0,2", Role::Runner, &[0, 2]),
        charge("runner 1,3", Role::Runner, &[1, 3]),
        charge("allocator 0", Role::Allocator, &[]),
        charge("allocator 1", Role::Allocator, &[]),
    ]
}

/// A process of a storm, by the name that [`raise_storm`] gives it.
///
/// # Errors
/// As [`runner_process`] and [`allocator_process`]; an unknown name.
pub(super) fn storm_process(domain: &Domain, name: &str, stop: &Stop) -> Result<(), Error> {
    let (contract, settings) = (team::contract(), ProcessSettings::default());
    let Some(("runner", agents)) = name.split_once(' ') else {
        let ended = allocator_process(domain, &contract, &mut StormAllocator, &settings, stop);
        return ended.map(drop);
    };
    let agents: Vec<u16> = agents.split(',').filter_map(|agent| agent.parse().ok()).collect();
    runner_process(domain, &contract, &agents, &mut StormPolicy, &settings, stop).map(drop)
}
