//! A world of one's own: waits for the runners of its domain, `SORTIE_DOMAIN`, and plays one episode with them.

use sortie_core::wire::FrameMut;
use sortie_core::{EntityMask, Shape, StepOutcome, UnavailableAction, World};
use sortie_ipc::{Domain, DomainContract, Stop, WorldSettings, world_process};

/// Two robots on a track of ten fields. Action 0 waits, action 1 goes on.
#[derive(Default)]
struct Track([u16; 2]);

impl World for Track {
    fn shape(&self) -> Shape {
        Shape { agents: 2, entities: 2, tasks: 0, actions: 2, features: 1 }
    }

    fn reset(&mut self) {
        self.0 = [0; 2];
    }

    fn observe(&self, frame: &mut FrameMut<'_>) {
        frame.set_present(&EntityMask::first(2));
        for (agent, field) in self.0.into_iter().enumerate() {
            frame.row_mut(agent).fill(f32::from(field) / 9.0);
            frame.set_observable(agent, &EntityMask::first(2));
            frame.available_mut(agent).copy_from_slice(&[1, u16::from(field < 9)]);
        }
    }

    fn step(&mut self, actions: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        self.0.iter_mut().zip(actions).for_each(|(field, action)| *field += action);
        Ok(StepOutcome { episode_ended: self.0 == [9; 2], tasks_changed: false })
    }
}

/// What policies must have been trained for.
pub(crate) fn contract() -> DomainContract {
    DomainContract { hash: 1, decision_interval: 1, safe_action: Some(0), ..Default::default() }
}

pub(crate) fn main() -> Result<(), Box<dyn std::error::Error>> {
    let domain = Domain::new(&std::env::var("SORTIE_DOMAIN").unwrap_or("default".into()))?;
    let settings = WorldSettings { episodes: Some(1), ..WorldSettings::default() };
    let (mut world, stop) = (Track::default(), Stop::on_signals()?);
    let counters =
        world_process(&domain, &contract(), &mut world, &settings, |_| Ok(()), &mut (), &stop)?;
    println!("{} ticks", counters.ticks);
    Ok(())
}
