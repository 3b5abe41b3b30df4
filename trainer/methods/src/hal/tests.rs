//! What the published learner does in an update, beside naive lists.

use sortie_envs::random::{below, chance, generator};
use sortie_envs::{Environment, Random};
use sortie_learn::Now;
use sortie_learn::learner::{Rules, Shard};
use sortie_learn::trajectory::{End, Place};
use sortie_nn::gradient_check::assert_gradient;
use sortie_nn::optimise::AdamRules;
use sortie_nn::tape::Tape;

use super::method::Update;
use super::{AffordancesConfig, Config, MetaConfig, ReturnsConfig};
use crate::options::tests::{Moment, at, greedy, keep, kept, values, world};
use crate::options::{
    Finished, Lesson, Mask, NONE, Next, Note, OptionPlace, QNetwork, Replay, ReplayConfig, returns,
};
use crate::pictures::{Body, Heads, NetworkShape, Shown};

const GOALS: usize = 3;
const EXPONENT: f32 = 0.7;

/// Networks, and what was played.
pub(super) struct Scene {
    world: Box<dyn Environment>,
    pub(super) shown: Shown,
    heads: Heads,
    pub(super) replay: Replay,
    config: Config,
}

impl Scene {
    /// What these settings keep; priorities, where there are any, differ.
    pub(super) fn new(settings: Config) -> Self {
        let world = world();
        let shown = Shown::new(world.spec(), 7, false, true).unwrap();
        let heads = Heads { goals: GOALS, actions: 11, dueling: true };
        let config = Config {
            returns: ReturnsConfig { steps: 4, ..settings.returns },
            replay: ReplayConfig { batch: 24, ..settings.replay },
            meta: MetaConfig { options: 3, batch: 16, ..settings.meta },
            ..settings
        };
        let replay = Replay::new(1, 400, GOALS).by_priority(config.replay.priorities, 100);
        let mut scene = Self { world, shown, heads, replay, config };
        scene.play();
        scene
    }

    /// States of a picture whose cells are drawn, in options that reach milestones now and then.
    fn play(&mut self) {
        let (mut random, mut played) = (generator(5), 0);
        while played < 300 {
            let (goal, steps) = (below(&mut random, GOALS) as u8, 1 + below(&mut random, 6) as u8);
            let reached =
                if chance(&mut random, 0.6) { below(&mut random, GOALS) as u8 } else { NONE };
            let is_over = chance(&mut random, 0.1);
            let mut start = None;
            for step in 1..=steps {
                let (action, ends_option) = (below(&mut random, 11) as u16, step == steps);
                let note = Note {
                    goal,
                    reached: if ends_option { reached } else { NONE },
                    option_reached: NONE,
                    ends_option,
                    ..Note::default()
                };
                let state = drawn_state(self.shown.bytes(), &mut random);
                let end = if is_over && ends_option { End::TimedOut } else { End::Open };
                let place = keep(&mut self.replay, &*self.world, (0, &state), (action, note), end);
                start.get_or_insert(place);
            }
            let (start, end) = (start.unwrap(), if is_over { End::TimedOut } else { End::Open });
            // Every set of milestones but none.
            let mask = 1 + played % 7;
            self.replay.finish(Finished { start, steps, goal, reached, mask, end });
            for step in 0..steps {
                let error = 0.1 + below(&mut random, 9) as f32;
                self.replay.correct_steps([(start.after(step.into()), error)].into_iter());
            }
            played += u32::from(steps);
        }
    }

    pub(super) fn shape(&self, heads: Heads) -> NetworkShape {
        let (body, picture) = (Body::Convolution, self.shown.shape());
        NetworkShape { body, picture, columns: self.shown.columns(), active: 1, width: 16, heads }
    }

    /// Weights, online ones and others for targets.
    fn learner(&self, heads: Heads) -> QNetwork {
        let rules = Rules::default();
        let adam = AdamRules { decay: 1e-5, ..rules.adam };
        let rules = Rules { target_rate: 0.0, adam, ..rules };
        let new = |seed| QNetwork::new(self.shape(heads), rules, &mut generator(seed));
        let mut learner = new(1);
        learner.learner.target = new(2).learner.target;
        learner
    }

    fn controller(&self) -> QNetwork {
        self.learner(self.heads)
    }

    fn meta_controller(&self) -> QNetwork {
        self.learner(self.heads.of_goals(true))
    }

    /// The values of a head's actions in a state, shown left for right or not, by the weights that learn and by those of
    /// targets, computed alone.
    fn values(&self, q: &QNetwork, place: Place, head: (bool, usize)) -> [Vec<f32>; 2] {
        let kept = (&self.replay, &self.shown);
        [&q.learner.online.values, &q.learner.target]
            .map(|weights| values((&q.network, weights), kept, (place, head.0, head.1)))
    }

    /// What a value that is looked up counts as.
    fn bounded(&self, value: f32) -> f32 {
        if self.config.returns.bounded { value.clamp(0.0, 1.0) } else { value }
    }

    fn update<'a>(&'a mut self, random: &'a mut Random) -> Update<'a> {
        let Self { config, replay, shown, world, .. } = self;
        Update { config, replay, shown, environment: &**world, exponent: EXPONENT, random }
    }

    fn draw_step(&mut self, random: &mut Random) -> Option<Lesson> {
        self.update(random).draw_step()
    }

    fn draw_option(&mut self, random: &mut Random) -> Option<(OptionPlace, Lesson)> {
        self.update(random).draw_option(GOALS)
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
        let mut q = scene.controller();
        // The same draws, one by one.
        let (mut random, mut drawn) = (generator(9), Vec::new());
        while drawn.len() < scene.config.replay.batch {
            drawn.extend(scene.draw_step(&mut random));
        }
        let least = drawn.iter().map(|it| it.priority).fold(f64::MAX, f64::min);
        let (mut loss, mut errors, mut turned) = (0.0, Vec::new(), 0);
        for lesson in &drawn {
            let (place, is_mirrored) = (lesson.state, lesson.is_mirrored);
            let note = *scene.replay.steps.note(place);
            let mut goals = vec![note.goal];
            let relabel = scene.config.returns.relabel;
            if relabel && note.option_reached != NONE && note.option_reached != note.goal {
                goals.push(note.option_reached);
            }
            // What is shown left for right was done left for right.
            let done = scene.replay.steps.actions(place)[0];
            let action = scene.world.turned_action(is_mirrored.into(), done);
            turned += usize::from(action != done);
            let weight = (least / lesson.priority).powf(EXPONENT.into());
            let mut sum = 0.0;
            for goal in &goals {
                let head = (is_mirrored, usize::from(*goal));
                let (rules, paid) =
                    (scene.config.returns.rules(), scene.config.returns.paid(*goal));
                let (earned, next) = returns(&scene.replay, place, rules, paid).unwrap();
                let follows = next.map_or(0.0, |next| {
                    let [chosen, worth] = scene.values(&q, next.place, head);
                    next.discount * scene.bounded(worth[greedy(&chosen)])
                });
                let [values, _] = scene.values(&q, place, head);
                let error = f64::from(values[usize::from(action)] - earned - follows);
                loss += 0.5 * (weight * error).powi(2) / drawn.len() as f64;
                sum += error.abs();
            }
            errors.push((place, sum / goals.len() as f64));
        }
        assert!(drawn.iter().any(|it| it.next.is_some()));
        assert_eq!(turned > 0, scene.config.returns.mirror);
        let exponent = scene.config.replay.priorities;
        assert_eq!(drawn.iter().any(|it| it.priority > least), exponent > 0.0);
        let found = scene.update(&mut generator(9)).controller(&mut q, 0.0).loss;
        assert!((found - loss).abs() < 1e-4 * loss, "{found} {loss}");
        // A step that was drawn now has the priority of its error.
        for _ in 0..200 {
            let (place, priority) = scene.replay.draw(scene.config.replay.reached, &mut random);
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
        let mut q = scene.meta_controller();
        let options: Vec<_> = (0..10).map(|number| ((0, number), 0.3 * number as f32)).collect();
        scene.replay.correct_options(options.into_iter());
        let (mut random, mut drawn) = (generator(9), Vec::new());
        while drawn.len() < scene.config.meta.batch {
            drawn.extend(scene.draw_option(&mut random));
        }
        let least = drawn.iter().map(|it| it.1.priority).fold(f64::MAX, f64::min);
        let (mut loss, mut errors, mut hidden) = (0.0, Vec::new(), 0);
        for (option, lesson) in &drawn {
            let head = (lesson.is_mirrored, 0);
            let course = scene.config.course(&scene.replay, *option, GOALS).unwrap();
            let follows = course.next.map_or(0.0, |next| {
                let [mut chosen, worth] = scene.values(&q, next.place, head);
                let any = greedy(&chosen);
                // What the mask hides behind an option is not chosen there.
                for (goal, value) in chosen.iter_mut().enumerate() {
                    if scene.config.meta.masked && next.mask >> goal & 1 == 0 {
                        *value = f32::NEG_INFINITY;
                    }
                }
                let [best, any] = [greedy(&chosen), any].map(|goal| scene.bounded(worth[goal]));
                hidden += usize::from(best != any);
                next.discount * best
            });
            let [values, _] = scene.values(&q, course.start, head);
            let error = f64::from(values[usize::from(course.goal)] - course.reward - follows);
            let weight = (least / lesson.priority).powf(EXPONENT.into());
            loss += 0.5 * (weight * error).powi(2) / drawn.len() as f64;
            errors.push((*option, error));
        }
        // Bounds make most of these values, of networks that have learned nothing, one.
        assert!(hidden > 0 || scene.config.returns.bounded || !scene.config.meta.masked);
        assert_eq!(drawn.iter().any(|it| it.1.is_mirrored), scene.config.returns.mirror);
        let found = scene.update(&mut generator(9)).meta(&mut q, 0.0).unwrap().loss;
        assert!((found - loss).abs() < 1e-4 * loss, "{found} {loss}");
        let exponent = scene.config.replay.priorities;
        for _ in 0..200 {
            let Some((option, lesson)) = scene.draw_option(&mut random) else { continue };
            for (_, error) in errors.iter().filter(|it| it.0 == option && exponent > 0.0) {
                assert!((lesson.priority - (error.abs() + 0.001).powf(exponent)).abs() < 1e-4);
            }
        }
    }
}

#[test]
fn gradients_of_updates_agree_with_finite_differences() {
    let mut scene = Scene::new(Config::paper());
    let mut random = generator(9);
    let steps = (0..60).filter_map(|_| scene.draw_step(&mut random)).collect();
    let options = (0..60).filter_map(|_| Some(scene.draw_option(&mut random)?.1)).collect();
    let lessons: [Vec<Lesson>; 2] = [steps, options];
    for (q, lessons) in [scene.controller(), scene.meta_controller()].into_iter().zip(lessons) {
        let mut unused = generator(1);
        let update = scene.update(&mut unused);
        let batch = update.lessons(&lessons);
        let loss = |weights: &[f32], gradient: Option<&mut [f32]>| {
            let [mut tape, mut spare] = [Tape::default(), Tape::default()];
            let mut shard = Shard {
                number: 0,
                pass: tape.begin(weights),
                spare: &mut spare,
                online: &q.learner.online.values,
                target: &q.learner.target,
                space: &mut Default::default(),
            };
            let loss = batch.loss(&q.network, &mut shard);
            gradient.into_iter().for_each(|it| shard.pass.backward(loss.total, it));
            loss.reported
        };
        let online = &q.learner.online.values;
        let mut gradient = vec![0.0; online.len()];
        loss(online, Some(&mut gradient));
        assert_gradient("an update", online, &gradient, |weights| loss(weights, None));
    }
}

/// The published returns of a list of rewards, step by step from the front.
fn naive(
    moments: &[Moment],
    start: usize,
    goal: u8,
    (rules, [worth, cost]): (&ReturnsConfig, [f32; 2]),
) -> Option<(f32, f32, Option<Place>)> {
    let is_time_out = |at: usize| moments[at].ends_option && moments[at].reached == NONE;
    if is_time_out(start) {
        return None;
    }
    let (mut sum, mut at) = (0.0, start);
    loop {
        let ahead = (at - start) as i32;
        let reached = moments[at].reached;
        let reward = match reached {
            _ if reached != NONE && reached == goal => worth,
            _ if reached != NONE && !rules.relabel => 0.0,
            _ => -cost,
        };
        sum += rules.discount.powi(ahead) * reward;
        at += 1;
        if reached != NONE {
            return Some((sum, 0.0, None));
        }
        if at - start == usize::from(rules.steps) || is_time_out(at) {
            return Some((sum, rules.discount.powi(ahead + 1), Some(Place::default().after(at))));
        }
    }
}

#[test]
fn published_returns_are_those_of_a_naive_list() {
    let step = Moment::default();
    let mut moments = vec![step; 40];
    // Options end by a milestone, by their time, where nothing can be reached, and with the episode's time.
    for (at, reached) in [(5, 1), (13, NONE), (14, 2), (20, NONE), (31, NONE), (39, 0)] {
        moments[at] = Moment { reached, ends_option: true, ..step };
    }
    (moments[20].terminated, moments[21].is_last) = (true, true);
    (moments[31].ends_option, moments[32].is_last) = (true, true);
    let replay = kept(&moments);
    for (steps, relabel) in [(10, true), (3, false), (1, true)] {
        let published = Config::paper().returns;
        let config = ReturnsConfig { steps, relabel, cost: 0.25, logarithm: false, ..published };
        for (start, goal) in (0..40).flat_map(|start| (0..3).map(move |goal| (start, goal))) {
            if moments[start].is_last {
                continue;
            }
            let found = returns(&replay, at(start), config.rules(), config.paid(goal));
            let found = found.map(|(earned, next)| {
                (earned, next.map_or(0.0, |next| next.discount), next.map(|next| next.place))
            });
            let want = naive(&moments, start, goal, (&config, [0.75, 0.25]));
            let close = match (found, want) {
                (Some(found), Some(want)) => {
                    let differences = [found.0 - want.0, found.1 - want.1];
                    found.2 == want.2 && differences.iter().all(|it| it.abs() < 1e-5)
                }
                (found, want) => found == want,
            };
            assert!(close, "{start} {goal} {steps}: {found:?} {want:?}");
        }
    }
}

#[test]
fn published_rewards_are_logarithms() {
    let returns = Config::paper().returns;
    let [worth, cost] = returns.worth();
    assert!((worth - 0.99277).abs() < 1e-5 && (cost - 0.014355).abs() < 1e-6);
    assert_eq!(ReturnsConfig::default().worth(), [1.0, 0.0]);
}

#[test]
fn values_come_to_what_was_earned() {
    let mut scene = Scene::new(Config::paper());
    scene.config.returns.discount = 0.9;
    let (mut q, mut losses) = (scene.controller(), Vec::new());
    for update in 1..=400 {
        let mut random = generator(update);
        losses.push(scene.update(&mut random).controller(&mut q, 1e-3).loss);
        if update % 100 == 0 {
            assert!(q.learner.target != q.learner.online.values);
            q.learner.copy_to_target();
            assert!(q.learner.target == q.learner.online.values);
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

fn next(number: usize, discount: f32, mask: u32) -> Option<Next> {
    Some(Next { place: at(number), discount, mask })
}

/// Returns of so many options.
fn courses(
    options: usize,
    [discount, step_discount]: [f32; 2],
    time_outs: bool,
    cost: f32,
) -> Config {
    let Config { returns, meta, .. } = Config::default();
    let returns = ReturnsConfig { time_outs, cost, relabel: true, logarithm: false, ..returns };
    let meta = MetaConfig { options, discount, step_discount, ..meta };
    Config { returns, meta, ..Config::default() }
}

#[test]
fn options_are_followed_to_the_end_of_their_episode() {
    let mut replay = kept(&[Moment::default(); 40]);
    let mut option =
        Finished { start: at(0), steps: 4, goal: 0, reached: NONE, mask: 0b101, end: End::Open };
    for (reached, end) in
        [(0, End::Open), (NONE, End::Open), (2, End::Over), (1, End::Open), (NONE, End::TimedOut)]
    {
        (option.reached, option.end) = (reached, end);
        replay.finish(option);
        option.start = option.start.after(4);
    }
    let config = courses(2, [0.5, 1.0], true, 0.0);
    let found = |number, relabel| {
        let mut config = config.clone();
        config.returns.relabel = relabel;
        let course = config.course(&replay, (0, number), 3)?;
        Some((course.goal, course.reward, course.next))
    };
    assert_eq!(found(0, true), Some((0, 0.0, next(8, 0.25, 0b101))));
    assert_eq!(found(1, true), Some((0, 0.5, None)));
    assert_eq!(found(2, true), Some((2, 1.0, None)));
    assert_eq!(found(2, false), Some((0, 1.0, None)));
    assert_eq!(found(3, true), Some((0, 0.0, next(20, 0.25, 0b111))));
    assert_eq!(found(4, true), Some((0, 0.0, next(20, 0.5, 0b111))));
    assert_eq!(found(5, true), None);
    // Solved are the options from the start of the episode on.
    let mut random = sortie_envs::random::generator(1);
    let draw = |_| replay.draw_option(1.0, &mut random).unwrap().0.1;
    let drawn: std::collections::BTreeSet<u32> = (0..50).map(draw).collect();
    assert_eq!(drawn.into_iter().collect::<Vec<_>>(), [0, 1, 2]);
}

#[test]
fn published_courses_pay_for_steps_that_reach_and_end_before_the_time_is_over() {
    let mut replay = kept(&[Moment::default(); 40]);
    let mut start = at(0);
    for (reached, end) in [
        (0, End::Open),
        (NONE, End::Open),
        (1, End::Over),
        (1, End::Open),
        (0, End::Open),
        (2, End::Over),
    ] {
        let mask = 0b11;
        replay.finish(Finished { start, steps: 4, goal: 1, reached, mask, end });
        start = start.after(4);
    }
    let config = courses(10, [0.5, 1.0], false, 0.25);
    let found = |number| {
        let course = config.course(&replay, (0, number), 3)?;
        Some((course.goal, course.reward, course.next))
    };
    assert_eq!(found(0), Some((1, -0.25, next(8, 0.25, 0b11))));
    assert_eq!(found(1), Some((1, 0.0, next(8, 0.5, 0b11))));
    assert_eq!(found(2), None);
    assert_eq!(found(3), Some((1, -0.25 - 0.125 + 0.1875, None)));
    assert_eq!(found(5), Some((2, 0.75, None)));
}

#[test]
fn a_course_is_discounted_for_every_option_and_every_step() {
    let mut replay = kept(&[Moment::default(); 40]);
    let mut start = at(0);
    for (steps, reached) in [(3, NONE), (5, 0), (2, NONE), (4, 2)] {
        let end = if reached == 2 { End::Over } else { End::Open };
        replay.finish(Finished { start, steps, goal: 1, reached, mask: 0b11, end });
        start = start.after(steps.into());
    }
    let config = courses(2, [0.75, 0.5], true, 0.25);
    let found = |number| {
        let course = config.course(&replay, (0, number), 3)?;
        Some((course.reward, course.next))
    };
    // So much is worth what comes behind options of so many steps in all.
    let worth = |options: i32, steps: i32| 0.75_f32.powi(options) * 0.5_f32.powi(steps);
    assert_eq!(found(0), Some((-0.25 * worth(1, 3), next(8, worth(2, 8), 0b11))));
    assert_eq!(found(1), Some((-0.25, next(10, worth(2, 7), 0b11))));
    assert_eq!(found(2), Some((0.75 * worth(1, 2), None)));
}
