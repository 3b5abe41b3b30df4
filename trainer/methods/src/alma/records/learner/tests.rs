use super::*;
use crate::alma::records::toy::toy;
use sortie_learn::random::{Purpose, generator};

/// A line through samples, by its slope and its height at 0.
#[derive(Clone, Debug, PartialEq)]
struct Line(Vec<f32>);

impl Parameters for Line {
    fn parts(&self) -> Vec<&[f32]> {
        vec![&self.0]
    }
    fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        vec![&mut self.0]
    }
}

impl Samples for Vec<(f32, f32)> {
    fn count(&self) -> usize {
        self.len()
    }
}

#[derive(Clone, Debug, Default)]
struct LineLoss {
    gradient: Vec<f32>,
    squared_error: f64,
    terms: usize,
}

impl Loss for LineLoss {
    type Network = Line;
    type Replay = Vec<(f32, f32)>;
    const CHUNK: usize = 3;

    fn learn(
        &mut self,
        networks: Networks<'_, Line>,
        experience: Experience<'_, Self::Replay>,
        picks: &[Pick],
    ) {
        let (slope, height) = (networks.online.0[0], networks.online.0[1]);
        let errors = picks.iter().map(|pick| {
            let (x, y) = experience.replay[pick.sample as usize];
            (x, slope * x + height - y)
        });
        let by_slope = errors.clone().map(|(x, error)| 2.0 * error * x).sum();
        self.gradient = vec![by_slope, errors.clone().map(|(_, error)| 2.0 * error).sum()];
        self.squared_error = errors.map(|(_, error)| f64::from(error * error)).sum();
        self.terms = picks.len();
    }
    fn squared_error(&self) -> f64 {
        self.squared_error
    }
    fn terms(&self) -> usize {
        self.terms
    }
    fn gradient(&self) -> &[f32] {
        &self.gradient
    }
}

#[test]
fn updates_find_the_line_through_the_samples() {
    let samples: Vec<_> = (-10..10).map(|x| (x as f32 * 0.1, x as f32 * 0.3 + 1.0)).collect();
    let samples = (samples, Observer::of(&toy()));
    let replay = ReplayConfig { batch: 8, ..ReplayConfig::default() };
    let optimiser = OptimiserConfig { target_rate: 0.0, ..OptimiserConfig::default() };
    let start = Line(vec![0.0, 0.0]);
    let mut learner =
        Learner::new((&replay, &optimiser), start.clone(), samples, &LineLoss::default());
    let mut picks = generator(1, Purpose::Replay, 0);
    let mut last = UpdateReport::default();
    for _ in 0..2000 {
        learner.pick(&mut picks);
        learner.job()();
        last = learner.follow(0.01);
    }
    let found = learner.knowledge().online.clone();
    assert!((found.0[0] - 3.0).abs() < 1e-3 && (found.0[1] - 1.0).abs() < 1e-3, "{found:?}");
    assert!(last.loss < 1e-6);
    assert_eq!(learner.knowledge().target, start, "a rate of zero moves no target");
    assert_ne!(learner.average, learner.knowledge().online);
}

#[test]
fn an_update_follows_the_mean_of_the_batch() {
    let replay = ReplayConfig { batch: 8, ..ReplayConfig::default() };
    let optimiser = OptimiserConfig { clip: 100.0, ..OptimiserConfig::default() };
    let (start, samples) = (Line(vec![1.0, 0.0]), (vec![(2.0, 3.0)], Observer::of(&toy())));
    let mut learner = Learner::new((&replay, &optimiser), start, samples, &LineLoss::default());
    let mut picks = generator(1, Purpose::Replay, 0);
    learner.pick(&mut picks);
    learner.job()();
    // Each of the eight terms: error 1 * 2 + 0 - 3, squared 1, slopes 2 * -1 * 2 and 2 * -1.
    let update = learner.follow(0.01);
    assert_eq!((update.loss, update.gradient_norm), (1.0, 20.0_f32.sqrt()));
    // The first step of Adam is as long as the learning rate, whatever the slope.
    let first = learner.knowledge().online.clone();
    assert!((first.0[0] - 1.01).abs() < 1e-6 && (first.0[1] - 0.01).abs() < 1e-6, "{first:?}");
    assert_eq!(learner.average, first);
    // The average begins as the plain mean of what was learned.
    learner.pick(&mut picks);
    learner.job()();
    learner.follow(0.01);
    let mean = (first.0[0] + learner.knowledge().online.0[0]) / 2.0;
    assert!((learner.average.0[0] - mean).abs() < 1e-6);
}

#[test]
fn samples_are_turned_by_all_symmetries_of_the_environment_or_by_none() {
    for (symmetries, turns) in [(true, vec![0, 1]), (false, vec![0])] {
        let replay = ReplayConfig { batch: 64, symmetries, ..ReplayConfig::default() };
        let optimiser = OptimiserConfig::default();
        let samples = (vec![(1.0, 1.0)], Observer::of(&toy()));
        let line = Line(vec![0.0; 2]);
        let mut learner = Learner::new((&replay, &optimiser), line, samples, &LineLoss::default());
        learner.pick(&mut generator(1, Purpose::Replay, 0));
        let picks = learner.knowledge().picks().to_vec();
        let mut drawn: Vec<u8> = picks.iter().map(|pick| pick.symmetry).collect();
        drawn.sort_unstable();
        drawn.dedup();
        assert_eq!(drawn, turns);
    }
}

#[test]
fn a_learner_is_warm_once_it_has_seen_enough() {
    let replay = ReplayConfig { warm_up: 2, ..ReplayConfig::default() };
    let optimiser = OptimiserConfig::default();
    let is_warm = |samples| {
        let (line, samples) = (Line(vec![0.0; 2]), vec![(1.0, 1.0); samples]);
        let samples = (samples, Observer::of(&toy()));
        Learner::new((&replay, &optimiser), line, samples, &LineLoss::default()).is_warm()
    };
    assert_eq!([1, 2, 3].map(is_warm), [false, true, true]);
}
