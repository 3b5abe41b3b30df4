//! SARSA on decisions, one target per open building.
//!
//! `y = discounted task rewards of the segment + discount * f_target(next state, building, its next team)`,
//! the next team being the one really sent next. A building that is closed by then adds nothing. Loss:
//! mean squared difference over all (decision, open building) pairs of the batch.

use sortie_envs::save_the_city::Symmetry;

use super::config::TeamValueConfig;
use super::input::{TeamQuery, TeamValueInput};
use super::segments::{Segment, Segments};
use crate::methods::alma::{UpdateReport, UtilityNetwork, UtilityPass};
use crate::optimise::{Adam, clip_norm, move_towards};
use crate::random::{Generator, below};
use crate::schedule::linear;

/// Decisions whose gradient is computed at a time: few enough for their activations to stay in cache.
const CHUNK: usize = 16;

/// The networks and the optimiser.
#[derive(Clone, Debug)]
pub struct TeamValueLearner {
    config: TeamValueConfig,
    /// The network that learns and decides while learning.
    pub online: UtilityNetwork,
    /// The network that values next decisions.
    pub target: UtilityNetwork,
    /// The moving average of the online weights: what is measured and shipped.
    pub average: UtilityNetwork,
    adam: Adam,
    gradient: Vec<f32>,
    pass: UtilityPass,
    input: TeamValueInput,
    /// The tasks of a chunk: segment number, building, target.
    targets: Vec<(usize, usize, f32)>,
    slopes: Vec<f32>,
}

impl TeamValueLearner {
    /// A learner that starts from a network.
    pub fn new(config: &TeamValueConfig, online: UtilityNetwork) -> Self {
        let parameters = online.shape().parameters();
        Self {
            target: online.clone(),
            average: online.clone(),
            adam: Adam::new(parameters, config.optimiser.epsilon),
            gradient: vec![0.0; parameters],
            pass: UtilityPass::new(online.shape()),
            input: TeamValueInput::default(),
            targets: Vec::new(),
            slopes: Vec::new(),
            config: config.clone(),
            online,
        }
    }

    /// The learning rate, so many decisions into the run.
    pub fn learning_rate(&self, decisions: u64) -> f32 {
        let optimiser = &self.config.optimiser;
        let (start, end) = (optimiser.learning_rate, optimiser.learning_rate_end);
        linear(start, end, self.config.run.decisions, decisions)
    }

    /// Learns from a batch drawn from the replay, which is not empty.
    pub fn update(
        &mut self,
        replay: &Segments,
        generator: &mut Generator,
        decisions: u64,
    ) -> UpdateReport {
        let turns = if self.config.replay.symmetries { Symmetry::ALL.len() } else { 1 };
        let picks: Vec<(&Segment, Symmetry)> = (0..self.config.replay.batch)
            .map(|_| {
                let segment = replay.get(below(generator, replay.len()));
                (segment, Symmetry::ALL[below(generator, turns)])
            })
            .collect();
        self.gradient.fill(0.0);
        let (mut squared_error, mut tasks) = (0.0, 0);
        for chunk in picks.chunks(CHUNK) {
            squared_error += self.learn(chunk);
            tasks += self.targets.len();
        }
        let count = tasks.max(1);
        self.gradient.iter_mut().for_each(|slope| *slope /= count as f32);
        let gradient_norm = self.follow_gradient(decisions);
        UpdateReport { loss: squared_error / count as f64, gradient_norm }
    }

    /// Adds the gradient of the summed squared errors of some segments, and returns that sum.
    fn learn(&mut self, picks: &[(&Segment, Symmetry)]) -> f64 {
        self.find_targets(picks);
        let queries = self.targets.iter().map(|(number, task, _)| {
            let (segment, turn) = picks[*number];
            let decision = &segment.now;
            TeamQuery { city: decision.city(), task: *task, team: decision.team(*task), turn }
        });
        let values = self.pass.forward(&self.online, self.input.queries(queries));
        self.slopes.clear();
        let mut squared_error = 0.0;
        for (value, (_, _, target)) in values.iter().zip(&self.targets) {
            let error = value - target;
            squared_error += f64::from(error) * f64::from(error);
            self.slopes.push(2.0 * error);
        }
        let input = self.input.input();
        self.pass.backward(&self.online, input, &self.slopes, &mut self.gradient);
        squared_error
    }

    /// Writes a target for every open building of every segment.
    fn find_targets(&mut self, picks: &[(&Segment, Symmetry)]) {
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
        let values = self.pass.forward(&self.target, self.input.queries(queries));
        let followed = self.targets.iter_mut().filter(|(number, task, _)| goes_on(*number, *task));
        for ((number, _, target), value) in followed.zip(values) {
            *target += picks[*number].0.discount * value;
        }
    }

    /// One optimiser step; returns the norm of the gradient before clipping.
    fn follow_gradient(&mut self, decisions: u64) -> f32 {
        let rate = self.learning_rate(decisions);
        let optimiser = &self.config.optimiser;
        let norm = clip_norm(&mut self.gradient, optimiser.clip);
        self.adam.step(self.online.parameters_mut(), &self.gradient, rate);
        let online = self.online.parameters();
        move_towards(self.target.parameters_mut(), online, optimiser.target_rate);
        // A plain mean at first, so that the initial weights do not linger.
        let average_rate = optimiser.average_rate.max(1.0 / self.adam.steps as f32);
        move_towards(self.average.parameters_mut(), online, average_rate);
        norm
    }
}

#[cfg(test)]
mod tests {
    use super::super::Decision;
    use super::*;
    use crate::layers::gradient_check::assert_gradient;
    use crate::random::{Purpose, generator};
    use sortie_envs::Environment;
    use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet, Status};

    fn config() -> TeamValueConfig {
        let mut config = TeamValueConfig::default();
        (config.network.width, config.network.base) = (16, 12);
        config.replay.batch = 24;
        config
    }

    fn network(seed: u64) -> UtilityNetwork {
        UtilityNetwork::initialise(config().shape(), 8.0, &mut generator(seed, Purpose::Weights, 0))
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

    fn learner(online: UtilityNetwork) -> TeamValueLearner {
        let mut learner = TeamValueLearner::new(&config(), online);
        learner.target = network(2);
        learner
    }

    #[test]
    fn the_gradient_of_the_loss_agrees_with_finite_differences() {
        let segments = segments();
        let picks: Vec<(&Segment, Symmetry)> =
            (0..20).map(|i| (segments.get(i), Symmetry::ALL[i % 8])).collect();
        let mut base = learner(network(1));
        base.learn(&picks);
        for tensor in base.online.shape().tensors() {
            let at = &base.online.parameters()[tensor.range.clone()];
            assert_gradient(tensor.name, at, &base.gradient[tensor.range.clone()], |moved| {
                let mut parameters = base.online.parameters().to_vec();
                parameters[tensor.range.clone()].copy_from_slice(moved);
                let online = UtilityNetwork::from_parameters(base.online.shape(), parameters);
                learner(online.unwrap()).learn(&picks)
            });
        }
    }

    #[test]
    fn closed_buildings_and_ended_episodes_do_not_bootstrap() {
        let segments = segments();
        let mut learner = learner(network(1));
        for number in 0..20 {
            let segment = segments.get(number);
            learner.find_targets(&[(segment, Symmetry::ALL[0])]);
            assert_eq!(learner.targets.len(), segment.now.buildings.len());
            for (_, task, target) in &learner.targets {
                let bootstraps = number % 5 != 0 && (*task != 0 || number % 2 != 0);
                assert_eq!(*target != *task as f32 - 1.0, bootstraps, "{number} {task}");
            }
        }
    }

    #[test]
    fn updates_learn_what_the_replay_says() {
        let (segments, mut picks) = (segments(), generator(1, Purpose::Replay, 0));
        let mut learner = learner(network(1));
        learner.config.optimiser.target_rate = 0.0;
        learner.config.replay.symmetries = false;
        let target = learner.target.clone();
        let losses: Vec<f64> =
            (0..300).map(|_| learner.update(&segments, &mut picks, 0).loss).collect();
        let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
        let (first, last) = (mean(&losses[..5]), mean(&losses[290..]));
        assert!(last < 0.25 * first, "loss {first} became {last}");
        assert_eq!(learner.target, target, "a rate of zero moves no target");
        assert_ne!(learner.average, learner.online);
    }
}
