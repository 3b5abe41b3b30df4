//! SARSA on decisions, one target per open building.
//!
//! `y = discounted task rewards of the segment + discount * f_target(next state, building, its next team)`,
//! the next team being the one really sent next. A building that is closed by then adds nothing. Loss:
//! squared difference. A drawn segment counts for one of the buildings that were open, drawn as well:
//! the buildings of one decision have much in common, and teach less together than those of several.

use sortie_envs::save_the_city::Symmetry;

use super::input::{TeamQuery, TeamValueInput};
use super::segments::{Decision, Segment, Segments};
use crate::alma::records::learner::{Loss, Networks, Pick};
use crate::alma::records::{UtilityNetwork, UtilityPass, UtilityShape};

/// A segment, one of the buildings that were open when it began, and how the map is turned.
#[derive(Clone, Copy, Debug)]
struct Picked<'a> {
    segment: &'a Segment,
    task: usize,
    turn: Symmetry,
}

impl<'a> Picked<'a> {
    /// The draw decides on the building. `None` where no building was open.
    fn new(replay: &'a Segments, pick: &Pick) -> Option<Self> {
        let segment = replay.get(pick.sample as usize);
        let open = || {
            let buildings = segment.now.buildings.iter().enumerate();
            buildings.filter(|(_, building)| building.is_open()).map(|(task, _)| task)
        };
        let place = (pick.draw as usize).checked_rem(open().count())?;
        let turn = Symmetry::ALL[usize::from(pick.symmetry)];
        open().nth(place).map(|task| Self { segment, task, turn })
    }

    /// Whether the building is still open at the next decision.
    fn goes_on(&self) -> bool {
        self.segment.discount > 0.0 && self.segment.next.buildings[self.task].is_open()
    }

    fn query(&self, decision: &'a Decision) -> TeamQuery<'a> {
        let Self { task, turn, .. } = *self;
        TeamQuery { city: decision.city(), task, team: decision.team(task), turn }
    }
}

/// Space to compute the gradient of some segments, and the result.
#[derive(Clone, Debug)]
pub struct TeamValueLoss {
    pass: UtilityPass,
    input: TeamValueInput,
    targets: Vec<f32>,
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
    fn descend(&mut self, online: &UtilityNetwork, picks: &[Picked<'_>]) {
        let queries = picks.iter().map(|picked| picked.query(&picked.segment.now));
        let values = self.pass.forward(online, self.input.queries(queries));
        self.slopes.clear();
        self.squared_error = 0.0;
        for (value, target) in values.iter().zip(&self.targets) {
            let error = value - target;
            self.squared_error += f64::from(error) * f64::from(error);
            self.slopes.push(2.0 * error);
        }
        self.gradient.fill(0.0);
        let input = self.input.input();
        self.pass.backward(online, input, &self.slopes, &mut self.gradient);
    }

    /// Writes the target of every picked building.
    fn find_targets(&mut self, target: &UtilityNetwork, picks: &[Picked<'_>]) {
        self.targets.clear();
        self.targets.extend(picks.iter().map(|picked| picked.segment.rewards[picked.task]));
        let followed = || picks.iter().zip(0..).filter(|(picked, _)| picked.goes_on());
        let queries = followed().map(|(picked, _)| picked.query(&picked.segment.next));
        let values = self.pass.forward(target, self.input.queries(queries));
        for ((picked, number), value) in followed().zip(values) {
            self.targets[number as usize] += picked.segment.discount * value;
        }
    }
}

impl Loss for TeamValueLoss {
    type Network = UtilityNetwork;
    type Replay = Segments;
    const CHUNK: usize = 64;

    fn learn(&mut self, networks: Networks<'_, UtilityNetwork>, replay: &Segments, picks: &[Pick]) {
        let picks: Vec<Picked<'_>> =
            picks.iter().filter_map(|pick| Picked::new(replay, pick)).collect();
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
    use super::*;
    use crate::alma::records::config::{AllocatorConfig, NetworkConfig};
    use sortie_envs::Environment;
    use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet, Status};
    use sortie_learn::random::{Purpose, generator};
    use sortie_nn::gradient_check::assert_gradient;

    fn network(seed: u64) -> UtilityNetwork {
        skipping(seed, false)
    }

    fn skipping(seed: u64, skip: bool) -> UtilityNetwork {
        let network = NetworkConfig { width: 16, base: 12, skip, ..NetworkConfig::default() };
        let shape = AllocatorConfig { network, ..AllocatorConfig::default() }.shape();
        UtilityNetwork::initialise(shape, 8.0, &mut generator(seed, Purpose::Weights, 0))
    }

    /// Segments between unrelated decisions; building 0 closes in every second one.
    fn segments() -> Segments {
        let set = ScenarioSet::named("2-5a_2-5b").unwrap();
        let mut city = SaveTheCity::new(set, Constants::default(), 1, 5).unwrap();
        let mut segments = Segments::new(20);
        let mut draws = sortie_envs::random::generator(5);
        city.reset(0, &mut draws);
        for number in 0..20_u8 {
            city.reset(0, &mut draws);
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
        (0..20).map(|i| Pick { sample: i, symmetry: (i % 8) as u8, draw: i.into() }).collect()
    }

    #[test]
    fn the_gradient_of_the_loss_agrees_with_finite_differences() {
        for skip in [false, true] {
            check_gradient(&skipping(1, skip), &skipping(2, skip));
        }
    }

    fn check_gradient(online: &UtilityNetwork, target: &UtilityNetwork) {
        let segments = segments();
        let learn = |online: &UtilityNetwork| {
            let mut loss = TeamValueLoss::new(online.shape());
            loss.learn(Networks { online, target }, &segments, &picks());
            loss
        };
        let base = learn(online);
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
            let tasks = segments.get(number).now.buildings.len();
            for task in 0..tasks {
                let pick = Pick { sample: number as u32, symmetry: 0, draw: task as u64 };
                loss.find_targets(&target, &[Picked::new(&segments, &pick).unwrap()]);
                let bootstraps = number % 5 != 0 && (task != 0 || number % 2 != 0);
                assert_eq!(loss.targets[0] != task as f32 - 1.0, bootstraps, "{number} {task}");
            }
        }
    }
}
