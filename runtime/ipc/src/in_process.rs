//! A whole team in one thread: the same roles, without shared memory.

use std::time::Duration;

use sortie_core::link::{Clock, Direct, DirectCursor, FrameBlock};
use sortie_core::roles::{
    AllocatorOptions, AllocatorRole, Counters, Identity, Poll, RunnerOptions, RunnerRole,
    WorldObserver, WorldRole,
};
use sortie_core::{Allocator, Policy, World};

use crate::domain::{DomainContract, DomainFacts};
use crate::error::Error;
use crate::processes::{WorldSettings, into_allocator_error, into_world_error};
use crate::stop::{MonotonicClock, Stop};

/// Longest pause before the next look at the stop flag.
const LONGEST_PAUSE: Duration = Duration::from_millis(100);

/// A team that acts in one thread.
pub struct InProcess<'a> {
    /// What it acts in.
    pub world: &'a mut dyn World,
    /// Acts for all agents.
    pub policy: &'a mut dyn Policy,
    /// Assigns them to subtasks.
    pub allocator: Option<&'a mut dyn Allocator>,
}

/// Runs the team until its episodes are done. Deterministic: nobody waits for time, so the
/// patience and period of `settings` do not count, nor do its flags `allocator` and `private`.
///
/// # Errors
/// A role fails, or a signal came.
pub fn run_in_process(
    team: InProcess<'_>,
    contract: &DomainContract,
    settings: &WorldSettings,
    observer: &mut dyn WorldObserver,
    stop: &Stop,
) -> Result<Counters, Error> {
    let InProcess { world, policy, mut allocator } = team;
    let format = DomainFacts::new(contract, world.shape()).format()?;
    let pid = std::process::id();
    let settings = WorldSettings {
        patience: Duration::ZERO,
        period: Duration::ZERO,
        required: u64::MAX,
        allocator: allocator.is_some(),
        ..*settings
    };
    let mut world_role = WorldRole::new(settings.options(contract, format, 1));
    let mut runner_role = RunnerRole::new(RunnerOptions {
        format,
        identity: Identity::new(pid, "runner/0"),
        agents: format.layout.every_agent() & !settings.absent,
        subtasks: contract.subtasks,
        decision_interval: contract.decision_interval,
        period_ns: 0,
        safe_action: contract.safe_action,
    });
    let mut allocator_role = AllocatorRole::new(AllocatorOptions {
        format,
        identity: Identity::new(pid, "allocator"),
        decision_interval: contract.decision_interval,
    });
    let mut memory = vec![FrameBlock::zeroed(); format.layout.payload_bytes() / 64];
    let mut team = Direct::new(&mut memory, &MonotonicClock);
    let [mut world_cursor, mut runner_cursor, mut allocator_cursor] = [DirectCursor::default(); 3];
    runner_role.join(&mut team.agent(&mut runner_cursor))?;
    if allocator.is_some() {
        allocator_role.lead(1);
        allocator_role.join(&mut team.allocator(&mut allocator_cursor))?;
    }
    loop {
        if stop.is_set() {
            return Err(Error::Interrupted);
        }
        let mut link = team.world(&mut world_cursor);
        let polled = world_role.poll(&mut link, world, observer).map_err(into_world_error)?;
        let mut is_moving = polled.is_progress();
        if polled == Poll::Ended {
            return Ok(*world_role.counters());
        }
        if let Some(allocator) = allocator.as_deref_mut() {
            let mut link = team.allocator(&mut allocator_cursor);
            let polled = allocator_role.poll(&mut link, allocator).map_err(into_allocator_error)?;
            is_moving |= polled.is_progress();
        }
        let mut link = team.agent(&mut runner_cursor);
        is_moving |= runner_role.poll(&mut link, policy)?.is_progress();
        if !is_moving {
            pause(polled)?;
        }
    }
}

/// Waits for the world's next frame where it is paced: nothing else can be waited for.
fn pause(world: Poll) -> Result<(), Error> {
    let Poll::Wait { until_ns } = world else { return Ok(()) };
    if until_ns == u64::MAX {
        return Err(Error::Stalled);
    }
    let left = Duration::from_nanos(until_ns.saturating_sub(MonotonicClock.now_ns()));
    std::thread::sleep(left.min(LONGEST_PAUSE));
    Ok(())
}
