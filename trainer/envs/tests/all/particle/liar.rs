//! An environment that says other things of itself than it does, which the laws of all environments find.

use sortie_envs::{
    EntitySet, Environment, Episode, Observation, Random, Spec, Split, StateError, Step, StepError,
    conformance,
};

use super::opened;

struct Liar {
    honest: Box<dyn Environment>,
    spec: Spec,
}

impl Environment for Liar {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.honest.instances()
    }

    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment> {
        Box::new(Self { honest: self.honest.open(instances, split), spec: self.spec.clone() })
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        self.honest.reset(instance, random);
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        self.honest.step(instance, actions, random)
    }

    fn agent_rewards(&self, instance: usize) -> &[f64] {
        self.honest.agent_rewards(instance)
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        self.honest.save(instance, state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        self.honest.load(instance, state)
    }

    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation) {
        self.honest.observe(state, turn, wanted, seen);
    }

    fn episode(&self, instance: usize) -> Episode {
        self.honest.episode(instance)
    }
}

#[test]
fn roles_that_see_or_do_more_than_they_say_are_found() {
    let found = |lie: fn(&mut Spec)| {
        let honest = opened("rover-tower-8", &[]);
        let mut spec = honest.spec().clone();
        lie(&mut spec);
        conformance::check(&Liar { honest, spec }, 1, 1)
    };
    assert_eq!(found(|_| {}), Ok(()));
    let sees = found(|spec| {
        spec.roles[1].features.pop();
        spec.roles[1].units.pop();
    });
    assert!(sees.as_ref().is_err_and(|law| law.contains("impossible features")), "{sees:?}");
    let does = found(|spec| spec.roles[1].actions.truncate(4));
    assert!(does.as_ref().is_err_and(|law| law.contains("agent 4 may do 11111")), "{does:?}");
}
