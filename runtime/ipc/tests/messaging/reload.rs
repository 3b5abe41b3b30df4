//! Processes that change to another model while they run.

use std::time::Duration;

use sortie_core::roles::{TickReport, WorldObserver};
use sortie_core::wire::{Command, ControlStatus, Role};
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_ipc::{
    AllocatorProcess, Answer, Children, Domain, Ended, Error, LoadedModel, Order, ProcessSettings,
    Registry, RunnerProcess, Stop, WorldSettings, control, world_process,
};

use crate::processes::{child, settings};
use crate::toy::{self, SHAPE, ToyAllocator, ToyWorld, Watchdog};

/// The role of a child with a registry, before `allocator` or its agents.
pub(crate) const RELOADS: &str = "reloads ";
/// The model that children start with; those of the registry are called by their first byte.
const FIRST: [u8; 16] = [1; 16];

/// Models `2` and `3`, `foreign` of another contract, and `small`.
struct Models {
    loaded: Option<u8>,
}

impl Registry for Models {
    fn load(&mut self, key: &str) -> Result<LoadedModel, ControlStatus> {
        let number = match key {
            "2" => 2,
            "3" => 3,
            "foreign" | "small" => 9,
            _ => return Err(ControlStatus::BadArgument),
        };
        self.loaded = Some(number);
        Ok(LoadedModel {
            contract: toy::contract().hash ^ u64::from(key == "foreign"),
            id: [number; 16],
            entities_max: if key == "small" { 1 } else { SHAPE.entities },
            tasks_max: SHAPE.tasks,
        })
    }
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
        Ok(Decision { action: 1, utility: self.0.into() })
    }
}

/// What a child does.
pub(crate) fn act(
    role: &str,
    domain: &Domain,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<sortie_core::roles::Counters, Error> {
    let (contract, mut models) = (toy::contract(), Models { loaded: Some(1) });
    let settings = ProcessSettings { model: FIRST, ..*settings };
    let role = role.trim_start_matches(RELOADS);
    if role == "allocator" {
        let mut process = AllocatorProcess::join(domain, &contract, &settings, stop)?;
        let mut ended = Ok(Ended::ForNextModel);
        while matches!(ended, Ok(Ended::ForNextModel)) {
            ended = process.allocate(&mut ToyAllocator, Some(&mut models), stop);
        }
        let left = process.leave();
        return ended.and(left);
    }
    let agents: Vec<u16> = role.split(',').map(|agent| agent.parse().unwrap()).collect();
    let mut process = RunnerProcess::join(domain, &contract, &agents, &settings, stop)?;
    let mut ended = Ok(Ended::ForNextModel);
    while matches!(ended, Ok(Ended::ForNextModel)) {
        let mut policy = Numbered(models.loaded.take().unwrap());
        ended = process.act(&mut policy, None, Some(&mut models), stop);
    }
    let left = process.leave();
    ended.and(left)
}

/// Tells the team to reload as it goes, and checks that every answer names the model that gave it.
struct Watch {
    domain: Domain,
    /// Keys to load, and what is to come of it.
    orders: Vec<(&'static str, ControlStatus, u8)>,
    /// The model that the team is to have now.
    model: u8,
    asked: Option<std::thread::JoinHandle<Vec<Answer>>>,
    stop: Stop,
}

impl WorldObserver for Watch {
    fn tick(&mut self, report: &TickReport<'_>) {
        let decided = report.answers().filter(|answer| answer.q != 0.0);
        let models: Vec<u8> = decided
            .map(|answer| {
                let model = answer.model.to_le_bytes()[0];
                assert_eq!(answer.q, f32::from(model));
                model
            })
            .collect();
        match self.asked.take() {
            Some(asking) if asking.is_finished() => {
                let answers = asking.join().unwrap();
                let (key, status, model) = self.orders.remove(0);
                assert_eq!(answers.len(), 3, "{key}: {answers:?}");
                assert!(answers.iter().all(|answer| answer.status == Some(status)), "{key}");
                assert!(answers.iter().all(|answer| answer.process.role != Role::World));
                assert!(answers.iter().all(|answer| answer.process.model == [model; 16]), "{key}");
                self.model = model;
            }
            Some(asking) => self.asked = Some(asking),
            None if models.is_empty() => {}
            None => {
                assert!(models.iter().all(|&model| model == self.model), "{models:?}");
                let Some((key, ..)) = self.orders.first() else { return self.stop.stop() };
                let order = Order::new(Command::ReloadModel).with_text(key);
                let domain = self.domain.clone();
                self.asked = Some(std::thread::spawn(move || control(&domain, &order).unwrap()));
            }
        }
    }
}

#[test]
fn a_team_changes_its_model_between_two_ticks_and_keeps_it_where_another_does_not_fit() {
    let _watchdog = Watchdog::new();
    let (domain, stop) = (toy::domain(), Stop::new());
    let mut watch = Watch {
        domain: domain.clone(),
        orders: vec![
            ("2", ControlStatus::Done, 2),
            ("none", ControlStatus::BadArgument, 2),
            ("foreign", ControlStatus::Foreign, 2),
            ("small", ControlStatus::Foreign, 2),
            ("3", ControlStatus::Done, 3),
        ],
        model: 1,
        asked: None,
        stop: stop.clone(),
    };
    let start = |children: &mut Children| {
        let roles = ["reloads allocator", "reloads 0,2", "reloads 1"];
        roles.iter().try_for_each(|role| children.spawn(*role, &mut child(&domain, role)))
    };
    let settings = WorldSettings {
        episodes: None,
        tick_interval: Duration::from_millis(1),
        patience: Duration::from_secs(20),
        ..settings(0)
    };
    let (contract, mut world) = (toy::contract(), ToyWorld::new());
    let played = world_process(&domain, &contract, &mut world, &settings, start, &mut watch, &stop);
    assert!(matches!(played, Err(Error::Interrupted)), "{played:?}");
    assert!(watch.orders.is_empty());
    assert_eq!(toy::leftovers(&domain), [""; 0]);
}
