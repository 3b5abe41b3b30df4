//! SARSA on decisions, one target per open building.
//!
//! `y = discounted task rewards of the segment + discount * f_target(next state, building, its next team)`,
//! the next team being the one really sent next. A building that is closed by then adds nothing. Loss:
//! mean squared difference over all (decision, open building) pairs of the batch.

use sortie_envs::save_the_city::Symmetry;

use super::input::{TeamQuery, TeamValueInput};
use super::segments::{Segment, Segments};
use crate::methods::alma::learner::{Loss, Networks, Pick};
use crate::methods::alma::{UtilityNetwork, UtilityPass, UtilityShape};

/// Space to compute the gradient of some segments, and the result.
#[derive(Clone, Debug)]
pub struct TeamValueLoss {
    pass: UtilityPass,
    input: TeamValueInput,
    /// The tasks of the segments: segment number, building, target.
    targets: Vec<(usize, usize, f32)>,
    slopes: Vec<f32>,
    gradient: Vec<f32>,
    squared_error: f64,
}

impl TeamValueLoss {
    /// Empty space for networks of a shape.
    pub fn new(shape: UtilityShape) -> Self {
        Self {
            pass: UtilityPass::new(shape),
            input: TeamValueInput::default(),
            targets: Vec::new(),
            slopes: Vec::new(),
            gradient: vec![0.0; shape.parameters()],
            squared_error: 0.0,
        }
    }

    /// Floating-point operations up to now, as [`UtilityPass::operations`] counts them.
    pub fn operations(&self) -> u64 {
        self.pass.operations()
    }

    /// Computes the gradient of the summed squared differences to the targets.
    fn descend(&mut self, online: &UtilityNetwork, picks: &[(&Segment, Symmetry)]) {
        let queries = self.targets.iter().map(|(number, task, _)| {
            let (segment, turn) = picks[*number];
            let decision = &segment.now;
            TeamQuery { city: decision.city(), task: *task, team: decision.team(*task), turn }
        });
        let values = self.pass.forward(online, self.input.queries(queries));
        self.slopes.clear();
        self.squared_error = 0.0;
        for (value, (_, _, target)) in values.iter().zip(&self.targets) {
            let error = value - target;
            self.squared_error += f64::from(error) * f64::from(error);
            self.slopes.push(2.0 * error);
        }
        self.gradient.fill(0.0);
        let input = self.input.input();
        self.pass.backward(online, input, &self.slopes, &mut self.gradient);
    }

    /// Writes a target for every open building of every segment.
    fn find_targets(&mut self, target: &UtilityNetwork, picks: &[(&Segment, Symmetry)]) {
        self.targets.clear();
        for (number, (segment, _)) in picks.iter().enumerate() {
            let buildings = segment.now.buildings.iter().zip(&segment.rewards).enumerate();
            let open = buildings.filter(|(_, (building, _))| building.is_open());
            self.targets.extend(open.map(|(task, (_, reward))| (number, task, *reward)));
        }
        let goes_on = |number: usize, task: usize| {
            let segment = picks[number].0;
            segment.discount > 0.0 && segment.next.buildings[task].is_open()
        };
        let followed = self.targets.iter().filter(|(number, task, _)| goes_on(*number, *task));
        let queries = followed.map(|(number, task, _)| {
            let (segment, turn) = picks[*number];
            let decision = &segment.next;
            TeamQuery { city: decision.city(), task: *task, team: decision.team(*task), turn }
        });
        let values = self.pass.forward(target, self.input.queries(queries));
        let followed = self.targets.iter_mut().filter(|(number, task, _)| goes_on(*number, *task));
        for ((number, _, target), value) in followed.zip(values) {
            *target += picks[*number].0.discount * value;
        }
    }
}

impl Loss for TeamValueLoss {
    type Network = UtilityNetwork;
    type Replay = Segments;
    const CHUNK: usize = 16;

    fn learn(&mut self, networks: Networks<'_, UtilityNetwork>, replay: &Segments, picks: &[Pick]) {
        let turned = |pick: &Pick| {
            (replay.get(pick.sample as usize), Symmetry::ALL[usize::from(pick.symmetry)])
        };
        let picks: Vec<(&Segment, Symmetry)> = picks.iter().map(turned).collect();
        self.find_targets(networks.target, &picks);
        self.descend(networks.online, &picks);
    }

    fn squared_error(&self) -> f64 {
        self.squared_error
    }

    fn terms(&self) -> usize {
        self.targets.len()
    }

    fn gradient(&self) -> &[f32] {
        &self.gradient
    }
}

#[cfg(test)]
mod tests {
    use super::super::Decision;
    use super::*;
    use crate::layers::gradient_check::assert_gradient;
    use crate::methods::alma::config::{AllocatorConfig, NetworkConfig};
    use crate::methods::alma::learner::Parameters;
    use crate::random::{Purpose, generator};
    use sortie_envs::Environment;
    use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet, Status};

    fn network(seed: u64) -> UtilityNetwork {
        let network = NetworkConfig { width: 16, base: 12, ..NetworkConfig::default() };
        let shape = AllocatorConfig { network, ..AllocatorConfig::default() }.shape();
        UtilityNetwork::initialise(shape, 8.0, &mut generator(seed, Purpose::Weights, 0))
    }

    /// Segments between unrelated decisions; building 0 closes in every second one.
    fn segments() -> Segments {
        let set = ScenarioSet::named("2-5a_2-5b").unwrap();
        let mut city = SaveTheCity::new(set, Constants::default(), 1, 5).unwrap();
        let mut segments = Segments::new(20);
        for number in 0..20_u8 {
            city.reset(0);
            let now = Decision::new(city.city(0), &[number % 3, 1, 2, 0, 1]);
            let mut next = Decision { allocation: vec![1; now.allocation.len()], ..now.clone() };
            if number % 2 == 0 {
                next.buildings[0].status = Status::Complete;
            }
            let rewards = (0..now.buildings.len()).map(|task| task as f32 - 1.0).collect();
            let discount = if number % 5 == 0 { 0.0 } else { 0.95 };
            segments.push(Segment { now, rewards, discount, next });
        }
        segments
    }

    fn picks() -> Vec<Pick> {
        (0..20).map(|i| Pick { sample: i, symmetry: (i % 8) as u8 }).collect()
    }

    #[test]
    fn the_gradient_of_the_loss_agrees_with_finite_differences() {
        let (segments, online, target) = (segments(), network(1), network(2));
        let learn = |online: &UtilityNetwork| {
            let mut loss = TeamValueLoss::new(online.shape());
            loss.learn(Networks { online, target: &target }, &segments, &picks());
            loss
        };
        let base = learn(&online);
        for tensor in online.shape().tensors() {
            let at = &online.parameters()[tensor.range.clone()];
            assert_gradient(tensor.name, at, &base.gradient()[tensor.range.clone()], |moved| {
                let mut parameters = online.parameters().to_vec();
                parameters[tensor.range.clone()].copy_from_slice(moved);
                let online = UtilityNetwork::from_parameters(online.shape(), parameters);
                learn(&online.unwrap()).squared_error()
            });
        }
    }

    #[test]
    fn closed_buildings_and_ended_episodes_do_not_bootstrap() {
        let (segments, target) = (segments(), network(2));
        let mut loss = TeamValueLoss::new(target.shape());
        for number in 0..20 {
            let segment = segments.get(number);
            loss.find_targets(&target, &[(segment, Symmetry::ALL[0])]);
            assert_eq!(loss.targets.len(), segment.now.buildings.len());
            for (_, task, target) in &loss.targets {
                let bootstraps = number % 5 != 0 && (*task != 0 || number % 2 != 0);
                assert_eq!(*target != *task as f32 - 1.0, bootstraps, "{number} {task}");
            }
        }
    }
}
