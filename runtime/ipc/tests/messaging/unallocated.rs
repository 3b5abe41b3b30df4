//! Teams of real processes without any allocator: agents act unallocated, or as a heuristic has them.

use std::time::Duration;

use sortie_core::allocate::{CostAllocator, CostMethod, CostModel};
use sortie_core::roles::{TickReport, WorldObserver};
use sortie_core::wire::{ActionMsg, Role, StatMsg};
use sortie_core::{AllocateError, AllocationState, UNASSIGNED};
use sortie_ipc::{
    Children, Domain, Error, ProcessSettings, Stop, WorldSettings, runner_process_with_heuristic,
    world_process,
};

use crate::processes::child;
use crate::toy::{self, SHAPE, ToyPolicy, ToyWorld, Watchdog};

/// The role of a child that acts as a heuristic has it, before its agents.
pub(crate) const HEURISTIC: &str = "heuristic ";
/// The toy's safe action.
const SAFE: u16 = 1;

/// The subtask at an even distance from the agent's number is the cheap one.
struct Distance;

impl CostModel for Distance {
    fn costs(
        &mut self,
        state: &AllocationState<'_>,
        costs: &mut [f32],
    ) -> Result<(), AllocateError> {
        for (place, cost) in costs.iter_mut().enumerate() {
            *cost = ((place / state.tasks + place % state.tasks) % 2) as f32;
        }
        Ok(())
    }
}

/// A runner whose agents find their subtasks by cost, each for itself.
pub(crate) fn act_by_cost(
    domain: &Domain,
    agents: &[u16],
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<(), Error> {
    let mut heuristic = CostAllocator {
        model: Distance,
        method: CostMethod::Greedy,
        team_max: SHAPE.agents,
        costs: &mut [0.0; SHAPE.agents * SHAPE.tasks],
    };
    let (contract, policy) = (toy::contract(), &mut ToyPolicy);
    runner_process_with_heuristic(domain, &contract, agents, policy, &mut heuristic, settings, stop)
        .map(drop)
}

/// The subtask by cost, while both are open or only the second is.
fn cheap_task(agent: u16, step: u32) -> u8 {
    if step < toy::EPISODE / 2 { (agent % 2) as u8 } else { 1 }
}

/// Checks what agents without an allocation do, until the world says that it is degraded.
struct Watch {
    has_heuristic: bool,
    answers: u32,
    decisions: u32,
    is_degraded: bool,
    enough: Stop,
}

impl WorldObserver for Watch {
    fn status(&mut self, status: &StatMsg) {
        if status.role == Role::World as u8 {
            self.is_degraded |= status.has(StatMsg::DEGRADED);
        }
    }

    fn tick(&mut self, report: &TickReport<'_>) {
        for answer in report.answers() {
            assert!(answer.has(ActionMsg::NO_ALLOC) && !answer.has(ActionMsg::STALE_ALLOC));
            assert_eq!((answer.alloc_term, answer.alloc_epoch), (0, 0));
            self.answers += 1;
            if self.has_heuristic {
                // One that is back after silent ticks, on a busy machine, is counted on from the next frame on.
                let was_absent = report.absent >> answer.agent & 1 == 1;
                let task =
                    if was_absent { UNASSIGNED } else { cheap_task(answer.agent, report.step) };
                assert_eq!(answer.task, task);
                self.decisions += u32::from(answer.q != 0.0);
            } else {
                // Always available in the toy.
                assert_eq!((answer.task, answer.action), (UNASSIGNED, SAFE));
            }
        }
        if report.degraded && self.is_degraded && self.answers > 60 {
            self.enough.stop();
        }
    }
}

fn play(roles: &[&str], has_heuristic: bool) -> Watch {
    let _watchdog = Watchdog::new();
    let domain = toy::domain();
    let mut team = Children::default();
    for role in roles {
        team.spawn(*role, &mut child(&domain, role)).unwrap();
    }
    let enough = Stop::new();
    let mut watch = Watch {
        has_heuristic,
        answers: 0,
        decisions: 0,
        is_degraded: false,
        enough: enough.clone(),
    };
    let settings = WorldSettings {
        allocator: true,
        strict: false,
        join_patience: Duration::from_millis(300),
        period: Duration::from_millis(4),
        ..WorldSettings::default()
    };
    let (contract, start) = (toy::contract(), |_: &mut _| Ok(()));
    let mut world = ToyWorld::new();
    let played =
        world_process(&domain, &contract, &mut world, &settings, start, &mut watch, &enough);
    assert!(matches!(played, Err(Error::Interrupted)), "{played:?}");
    team.finish(Duration::from_secs(10));
    team.check().unwrap();
    assert_eq!(toy::leftovers(&domain), [""; 0]);
    watch
}

#[test]
fn without_any_allocator_agents_take_the_safe_action() {
    assert_eq!(play(&["0,2", "1"], false).decisions, 0);
}

#[test]
fn without_any_allocator_all_runners_act_on_the_same_heuristic() {
    let watch = play(&["heuristic 0,2", "heuristic 1"], true);
    assert!(watch.decisions > watch.answers / 4, "{} of {}", watch.decisions, watch.answers);
}
