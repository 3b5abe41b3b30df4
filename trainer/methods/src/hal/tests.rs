//! What the published learner does in an update, beside naive lists.

use sortie_envs::random::{below, chance, generator};
use sortie_envs::{Environment, Random, Split};
use sortie_learn::Now;
use sortie_learn::configuration::OptimiserConfig;
use sortie_nn::gradient_check::assert_gradient;

use super::method::{ControllerMemory, MetaMemory, update_controller, update_meta};
use super::{AffordancesConfig, Config, MetaConfig, ReturnsConfig};
use crate::options::naive::{greedy, values};
use crate::options::{
    End, Finished, Mask, Moment, NONE, Place, Replay, ReplayConfig, course, window,
};
use crate::pictures::{Body, Heads, Learner, NetworkShape, Shown};

const GOALS: usize = 3;
const EXPONENT: f32 = 0.7;

/// Networks, and what was played.
pub(super) struct Scene {
    world: Box<dyn Environment>,
    pub(super) shown: Shown,
    heads: Heads,
    pub(super) replay: Replay,
    returns: ReturnsConfig,
    sizes: ReplayConfig,
    meta: MetaConfig,
    /// What an update draws by.
    draws: u64,
}

impl Scene {
    /// What these settings keep; priorities, where there are any, differ.
    pub(super) fn new(settings: Config) -> Self {
        let world =
            sortie_envs::open("crafting/iron", Split::Train, 1, &Default::default()).unwrap();
        let shown = Shown::new(world.spec(), 7, false, true).unwrap();
        let heads = Heads { goals: GOALS, actions: 11, dueling: true };
        let Config { returns, replay, meta, .. } = settings;
        let kept = Replay::new(1, 400, shown.bytes(), GOALS);
        let kept = match replay.priorities {
            0.0 => kept,
            exponent => kept.by_priority(exponent, 100),
        };
        let mut scene = Self {
            world,
            shown,
            heads,
            replay: kept,
            returns: ReturnsConfig { steps: 4, ..returns },
            sizes: ReplayConfig { batch: 24, ..replay },
            meta: MetaConfig { options: 3, batch: 16, ..meta },
            draws: 9,
        };
        scene.play();
        scene
    }

    /// States of a picture whose cells are drawn, in options that reach milestones now and then.
    fn play(&mut self) {
        let mut random = generator(5);
        let mut start = Place { instance: 0, time: 0 };
        while start.time < 300 {
            let (goal, steps) = (below(&mut random, GOALS) as u8, 1 + below(&mut random, 6) as u8);
            let reached =
                if chance(&mut random, 0.6) { below(&mut random, GOALS) as u8 } else { NONE };
            let end = if chance(&mut random, 0.1) { End::TimedOut } else { End::GoesOn };
            for step in 1..=steps {
                let ends_option = step == steps;
                let moment = Moment {
                    action: below(&mut random, 11) as u8,
                    goal,
                    reached: if ends_option { reached } else { NONE },
                    option_reached: NONE,
                    ends_option,
                    ..Moment::default()
                };
                let state = drawn_state(self.shown.bytes(), &mut random);
                self.replay.push(0, &state, moment);
            }
            // Every set of milestones but none.
            let mask = 1 + start.time % 7;
            self.replay.finish(Finished { start, steps, goal, reached, mask, end });
            start = start.after(steps.into());
        }
        let errors: Vec<_> = (0..start.time)
            .map(|time| (Place { instance: 0, time }, 0.1 + below(&mut random, 9) as f32))
            .collect();
        self.replay.correct_steps(errors.into_iter());
    }

    /// Weights, online ones and others for targets.
    pub(super) fn learner(&self, outputs: usize) -> Learner {
        let (body, picture) = (Body::Convolution, self.shown.shape());
        let (columns, active, width) = (self.shown.columns(), 1, 16);
        let shape = NetworkShape { body, picture, columns, active, width, outputs };
        let mut learner = Learner::new(shape, &OptimiserConfig::default(), &mut generator(1));
        learner.target = Learner::new(shape, &OptimiserConfig::default(), &mut generator(2)).online;
        learner
    }

    /// The values of a head's actions in a state, shown left for right or not, by some weights, computed alone.
    fn values(
        &self,
        (learner, weights): (&Learner, &[f32]),
        place: Place,
        (is_mirrored, goal): (bool, usize),
    ) -> Vec<f32> {
        let heads = if learner.network.outputs() == self.heads.outputs() {
            self.heads
        } else {
            self.heads.of_goals(true)
        };
        values((learner, weights, heads), (&self.replay, &self.shown), (place, is_mirrored, goal))
    }

    /// An option and its priority: by priorities where there are any, else now and then of a solved episode.
    fn drawn_option(&mut self, random: &mut Random) -> ((u32, u32), f64) {
        self.replay.draw_option_by_priority(random).unwrap_or_else(|| {
            let is_solved = chance(random, self.meta.solved.into());
            let place = self.replay.draw_option(is_solved, random);
            (place.or_else(|| self.replay.draw_option(false, random)).unwrap(), 1.0)
        })
    }

    /// What a value that is looked up counts as.
    fn bounded(&self, value: f32) -> f32 {
        if self.returns.bounded { value.clamp(0.0, 1.0) } else { value }
    }

    fn descend(&mut self, learner: &mut Learner, memory: &mut ControllerMemory) -> f64 {
        let settings = (&self.returns, &self.sizes, EXPONENT);
        let kept = (&mut self.replay, &self.shown, &*self.world);
        update_controller(learner, self.heads, settings, kept, memory, &mut generator(self.draws))
    }

    fn descend_meta(&mut self, learner: &mut Learner) -> f64 {
        let settings = (&self.meta, &self.returns, EXPONENT);
        let kept = (&mut self.replay, &self.shown);
        let (heads, mut memory) = (self.heads.of_goals(true), MetaMemory::default());
        update_meta(learner, heads, settings, kept, &mut memory, &mut generator(9)).unwrap()
    }
}

fn drawn_state(bytes: usize, random: &mut Random) -> Vec<u8> {
    // Two bytes a cell, of nine channels; counts behind them.
    let cell = |at: usize| at < 98;
    (0..bytes)
        .map(|at| match () {
            () if cell(at) && at % 2 == 1 => 0,
            () if cell(at) => 1 << below(random, 8),
            () => below(random, 4) as u8,
        })
        .collect()
}

/// The published settings with and without hindsight, and those of the preset `fast` with and without bounds.
fn settings() -> [Config; 4] {
    let [published, mut chosen] = [Config::paper(), Config::paper()];
    chosen.returns.relabel = false;
    let [fast, mut unbounded] = [Config::default(), Config::default()];
    unbounded.returns.bounded = false;
    [published, chosen, fast, unbounded]
}

#[test]
fn an_update_of_the_controller_is_that_of_a_naive_list() {
    for settings in settings() {
        let mut scene = Scene::new(settings);
        let mut learner = scene.learner(scene.heads.outputs());
        // The same draws, one by one.
        let mut random = generator(9);
        let mut drawn = Vec::new();
        while drawn.len() < scene.sizes.batch {
            let (place, priority) = scene.replay.draw(scene.sizes.reached, &mut random);
            let window = window(&scene.replay, place, scene.returns.rules());
            let Some(window) = window else { continue };
            let is_mirrored = scene.returns.mirror && chance(&mut random, 0.5);
            drawn.push((place, priority, window, is_mirrored));
        }
        let least = drawn.iter().map(|it| it.1).fold(f64::MAX, f64::min);
        let (mut loss, mut errors, mut turned) = (0.0, Vec::new(), 0);
        for (place, priority, window, is_mirrored) in &drawn {
            let moment = scene.replay.moment(*place);
            let mut goals = vec![moment.goal];
            let relabel = scene.returns.relabel;
            if relabel && moment.option_reached != NONE && moment.option_reached != moment.goal {
                goals.push(moment.option_reached);
            }
            // What is shown left for right was done left for right.
            let action = scene.world.turned_action((*is_mirrored).into(), moment.action.into());
            turned += usize::from(action != u16::from(moment.action));
            let weight = (least / priority).powf(EXPONENT.into());
            let mut sum = 0.0;
            for goal in &goals {
                let head = (*is_mirrored, usize::from(*goal));
                let follows = window.next.map_or(0.0, |next| {
                    let chosen = scene.values((&learner, &learner.online), next, head);
                    let worth = scene.values((&learner, &learner.target), next, head);
                    window.discount * scene.bounded(worth[greedy(&chosen)])
                });
                let target = window.earned(*goal, scene.returns.rules()) + follows;
                let values = scene.values((&learner, &learner.online), *place, head);
                let error = f64::from(values[usize::from(action)] - target);
                loss += 0.5 * (weight * error).powi(2) / drawn.len() as f64;
                sum += error.abs();
            }
            errors.push((*place, sum / goals.len() as f64));
        }
        assert!(drawn.iter().any(|it| it.2.next.is_some()));
        assert_eq!(turned > 0, scene.returns.mirror);
        let exponent = scene.sizes.priorities;
        assert_eq!(drawn.iter().any(|it| it.1 > least), exponent > 0.0);
        let found = scene.descend(&mut learner, &mut ControllerMemory::default());
        assert!((found - loss).abs() < 1e-4 * loss, "{found} {loss}");
        // A step that was drawn now has the priority of its error.
        for _ in 0..200 {
            let (place, priority) = scene.replay.draw(scene.sizes.reached, &mut random);
            for (_, error) in errors.iter().filter(|it| it.0 == place && exponent > 0.0) {
                assert!((priority - (error + 0.001).powf(exponent)).abs() < 1e-4);
            }
        }
    }
}

#[test]
fn an_update_of_the_meta_controller_is_that_of_a_naive_list() {
    for settings in settings() {
        let mut scene = Scene::new(settings);
        let mut learner = scene.learner(scene.heads.of_goals(true).outputs());
        let options: Vec<_> = (0..10).map(|number| ((0, number), 0.3 * number as f32)).collect();
        scene.replay.correct_options(options.into_iter());
        let rules = scene.returns.course_rules(&scene.meta, GOALS);
        let mut random = generator(9);
        let mut drawn = Vec::new();
        while drawn.len() < scene.meta.batch {
            let (place, priority) = scene.drawn_option(&mut random);
            let Some(course) = course(&scene.replay, place, rules) else { continue };
            let is_mirrored = scene.returns.mirror && chance(&mut random, 0.5);
            drawn.push((place, priority, course, is_mirrored));
        }
        let least = drawn.iter().map(|it| it.1).fold(f64::MAX, f64::min);
        let (mut loss, mut errors, mut hidden) = (0.0, Vec::new(), 0);
        for (place, priority, course, is_mirrored) in &drawn {
            let head = (*is_mirrored, 0);
            let follows = course.next.map_or(0.0, |(next, mask)| {
                let mut chosen = scene.values((&learner, &learner.online), next, head);
                let any = greedy(&chosen);
                // What the mask hides behind an option is not chosen there.
                for (goal, value) in chosen.iter_mut().enumerate() {
                    if scene.meta.masked && mask >> goal & 1 == 0 {
                        *value = f32::NEG_INFINITY;
                    }
                }
                let worth = scene.values((&learner, &learner.target), next, head);
                let [best, any] = [greedy(&chosen), any].map(|goal| scene.bounded(worth[goal]));
                hidden += usize::from(best != any);
                course.discount * best
            });
            let values = scene.values((&learner, &learner.online), course.start, head);
            let error = f64::from(values[usize::from(course.goal)] - course.reward - follows);
            let weight = (least / priority).powf(EXPONENT.into());
            loss += 0.5 * (weight * error).powi(2) / drawn.len() as f64;
            errors.push((*place, error));
        }
        // Bounds make most of these values, of networks that have learned nothing, one.
        assert!(hidden > 0 || scene.returns.bounded || !scene.meta.masked);
        assert_eq!(drawn.iter().any(|it| it.3), scene.returns.mirror);
        let found = scene.descend_meta(&mut learner);
        assert!((found - loss).abs() < 1e-4 * loss, "{found} {loss}");
        let exponent = scene.sizes.priorities;
        for _ in 0..200 {
            let (place, priority) = scene.drawn_option(&mut random);
            for (_, error) in errors.iter().filter(|it| it.0 == place && exponent > 0.0) {
                assert!((priority - (error.abs() + 0.001).powf(exponent)).abs() < 1e-4);
            }
        }
    }
}

#[test]
fn gradients_of_updates_agree_with_finite_differences() {
    let scene = || Scene::new(Config::paper());
    let learner = scene().learner(scene().heads.outputs());
    let loss = |weights: &[f32]| {
        let mut learner = learner.clone();
        learner.online = weights.to_vec();
        let loss = scene().descend(&mut learner, &mut ControllerMemory::default());
        (loss, learner.gradient)
    };
    assert_gradient("controller", &learner.online, &loss(&learner.online).1, |it| loss(it).0);
    let learner = scene().learner(scene().heads.of_goals(true).outputs());
    let loss = |weights: &[f32]| {
        let mut learner = learner.clone();
        learner.online = weights.to_vec();
        (scene().descend_meta(&mut learner), learner.gradient)
    };
    assert_gradient("meta-controller", &learner.online, &loss(&learner.online).1, |it| loss(it).0);
}

#[test]
fn published_rewards_are_logarithms() {
    let returns = Config::paper().returns;
    let rules = returns.rules();
    assert!((rules.worth - 0.99277).abs() < 1e-5 && (rules.cost - 0.014355).abs() < 1e-6);
    assert!(!rules.forgives && ReturnsConfig { relabel: false, ..returns }.rules().forgives);
    let fast = ReturnsConfig::default().rules();
    assert_eq!((fast.worth, fast.cost), (1.0, 0.0));
}

#[test]
fn values_come_to_what_was_earned() {
    let mut scene = Scene::new(Config::paper());
    scene.returns.discount = 0.9;
    let mut learner = scene.learner(scene.heads.outputs());
    let optimiser = OptimiserConfig { target_rate: 0.0, ..OptimiserConfig::default() };
    let mut memory = ControllerMemory::default();
    let mut losses = Vec::new();
    for update in 1..=400 {
        scene.draws = update;
        losses.push(scene.descend(&mut learner, &mut memory));
        learner.step(&optimiser, 1e-3, 1e-5, losses[losses.len() - 1]);
        if update % 100 == 0 {
            assert!(learner.target != learner.online);
            learner.copy_to_target();
            assert!(learner.target == learner.online);
        }
    }
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    let [first, last] = [mean(&losses[..20]), mean(&losses[380..])];
    assert!(last < 0.1 * first, "{first} {last}");
}

#[test]
fn the_classifier_learns_when_it_is_due() {
    let due = |config: &AffordancesConfig, update| config.due(update).1.map(u8::from);
    let paper = Config::paper().affordances;
    let found = [10, 13, 16, 20, 23].map(|update| due(&paper, update));
    assert_eq!(found, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0]]);
    assert!([11, 12, 14, 15, 17, 18, 19].iter().all(|update| due(&paper, *update) == [0; 3]));
    let fast = AffordancesConfig::default();
    let found = [4, 8, 16, 17].map(|update| due(&fast, update));
    assert_eq!(found, [[1, 0, 1], [1, 0, 1], [1, 1, 1], [0, 0, 0]]);
}

#[test]
fn chances_change_as_published() {
    let exploration = Config::paper().exploration;
    let of = 1_025_600;
    let now = |env_steps| Now { env_steps, of };
    let near = |found: f32, want: f32| (found - want).abs() < 1e-5;
    let Config { exploration: fast, replay, .. } = Config::default();
    assert_eq!([6_399, 6_400].map(|step| fast.actions_at(now(step)) == 1.0), [true, false]);
    let updates = |replay: &ReplayConfig, first: u64, step| replay.due(first, now(step));
    assert_eq!([6_400, 6_655, 6_656].map(|step| updates(&replay, fast.first, step)), [0, 0, 1]);
    let replay = Config::paper().replay;
    assert_eq!([400, 403, 404].map(|step| updates(&replay, exploration.first, step)), [0, 0, 1]);
    assert!(exploration.actions_at(now(400)) < 0.5);
    for (step, want) in [(0, 1.0), (399, 1.0), (410_240, 0.275), (820_480, 0.05), (of, 0.05)] {
        assert!(near(exploration.actions_at(now(step)), want), "{step}");
    }
    for (step, learned) in [
        (6_399, [1.0, 0.0]),
        (6_400, [0.2, 0.8]),
        (25_600, [0.2, 0.8]),
        (425_600, [0.125, 0.4]),
        (825_600, [0.05, 0.0]),
    ] {
        let found = exploration.goals_at(Mask::Learned, now(step));
        assert!(near(found[0], learned[0]) && near(found[1], learned[1]), "{step} {found:?}");
        let oracle = exploration.goals_at(Mask::Oracle, now(step));
        let none = exploration.goals_at(Mask::None, now(step));
        let sum = learned[0] + learned[1];
        let want = if step < 6_400 { [1.0, 0.0] } else { [0.0, sum] };
        assert!(near(oracle[0], want[0]) && near(oracle[1], want[1]), "{step} {oracle:?}");
        assert!(near(none[0], learned[0]) && none[1] == 0.0, "{step} {none:?}");
    }
}
