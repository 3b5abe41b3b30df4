//! What exploring brings in the gridworld: treasures while learning and once frozen, steps and processor time.
//!
//! `cargo bench -p sortie-methods --bench exploration -- SET[:STEPS],... SEEDS|A..B [KEY=VALUE...]`
#![allow(clippy::print_stdout, reason = "a program of its own")]

use std::collections::VecDeque;

use rustix::time::{ClockId, clock_gettime};
use sortie_envs::registry::Setting;
use sortie_envs::{Environment, Random, Split};
use sortie_learn::play::{Play, evaluate};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{EpisodeCounts, Rates, Reports};
use sortie_learn::session::{Opening, Setup};
use sortie_learn::{Act, Ask, LearnError, Method, Now, State, Transition};
use sortie_methods::ma_exp::MA_EXP;

/// Training episodes that a mean is taken of.
const LAST: usize = 100;
/// Frozen episodes.
const FROZEN: usize = 200;

/// A method whose episodes are watched.
struct Watched {
    method: Box<dyn Method>,
    treasures: VecDeque<f64>,
}

impl Watched {
    /// Mean of treasures of the last episodes, once there are so many.
    fn mean(&self) -> Option<f64> {
        let full = self.treasures.len() == LAST;
        full.then(|| self.treasures.iter().sum::<f64>() / LAST as f64)
    }
}

impl Method for Watched {
    fn begins(&mut self, instance: usize, random: &mut Random) {
        self.method.begins(instance, random);
    }

    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        self.method.act(ask, now)
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        if transition.step.done() {
            let episode = transition.environment.episode(transition.instance);
            self.treasures.extend(episode.metrics[0]);
            self.treasures.drain(..self.treasures.len().saturating_sub(LAST));
        }
        self.method.remember(transition)
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        self.method.update(environment, now)
    }

    fn rates(&self, now: Now) -> Rates {
        self.method.rates(now)
    }

    fn team(&self) -> Box<dyn Act + '_> {
        self.method.team()
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.method.state(state)
    }
}

/// Seconds of processor time of this process.
fn processor() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// What a run came to.
struct Learned {
    last: f64,
    frozen: f64,
    length: f64,
    /// Environment steps and seconds until all but a tenth of a treasure was found.
    reached: Option<[f64; 2]>,
    seconds: f64,
}

fn learn(setup: &Setup, seed: u64) -> Result<Learned, LearnError> {
    let choice = &setup.environment;
    let mut settings = choice.settings.clone();
    if choice.set.starts_with("flip") {
        settings.entry("map_seed".into()).or_insert(Setting::Whole(seed as i64));
    }
    let world = sortie_envs::open(&choice.to_string(), Split::Train, 1, &settings)?;
    let most = if choice.set.starts_with("flip") { 8 } else { world.spec().shape.agents };
    let started = processor();
    let opening = Opening { setup, environment: &*world, seed, threads: 1 };
    let mut watched = Watched { method: MA_EXP.method(&opening)?, treasures: VecDeque::new() };
    let random = (0..choice.instances as u64).map(|index| generator(seed, Purpose::Rollout, index));
    let mut play = Play::new(&*world, &mut watched, random.collect());
    let mut counts = EpisodeCounts::default();
    let (mut env_steps, mut reached) = (0, None);
    while env_steps < setup.run.steps {
        let now = |env_steps| Now { env_steps, of: setup.run.steps };
        env_steps += play.round(&mut watched, now(env_steps), &mut counts)?;
        watched.update(&*world, now(env_steps))?;
        if reached.is_none() && watched.mean().is_some_and(|mean| mean >= most as f64 - 0.1) {
            reached = Some([env_steps as f64, processor() - started]);
        }
    }
    let seconds = processor() - started;
    let played = evaluate(&*world, &mut *watched.team(), FROZEN, 2_000_000)?;
    let last = watched.mean().unwrap_or(f64::NAN);
    let (frozen, length) = (played.metrics["treasures"], played.length_mean);
    Ok(Learned { last, frozen, length, reached, seconds })
}

/// Mean and standard deviation.
fn spread(numbers: &[f64]) -> String {
    let mean = numbers.iter().sum::<f64>() / numbers.len() as f64;
    let squares = numbers.iter().map(|number| (number - mean).powi(2)).sum::<f64>();
    format!("{mean:.2} ± {:.2}", (squares / numbers.len() as f64).sqrt())
}

fn main() -> Result<(), LearnError> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|it| it != "--bench").collect();
    let is_assignment = |it: &&String| it.contains('=');
    let assignments: Vec<&String> = arguments.iter().filter(is_assignment).collect();
    let mut words = arguments.iter().filter(|it| !is_assignment(it));
    let sets = words.next().map_or("task1-2,task2-2,task3-2", String::as_str);
    let seeds = words.next().map_or("6", String::as_str);
    let (first, last) = seeds.split_once("..").unwrap_or(("1", seeds));
    let number = |text: &str| text.parse::<u64>().expect("seeds are a number, or A..B");
    let seeds = number(first)..=number(last);
    println!(
        "| set | steps | last {LAST} | frozen | its length | all but a tenth: k steps | CPU s | CPU s of the run |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    for set in sets.split(',') {
        let (name, steps) = set.split_once(':').unwrap_or((set, ""));
        let mut setup = MA_EXP.preset("fast")?;
        setup.environment.name = "gridworld".to_owned();
        setup.environment.set = name.to_owned();
        let world = sortie_envs::open(
            &setup.environment.to_string(),
            Split::Train,
            1,
            &Default::default(),
        )?;
        (MA_EXP.suit)("fast", &mut setup, world.spec());
        let steps = (!steps.is_empty()).then(|| format!("run.steps={steps}"));
        for assignment in steps.iter().chain(assignments.iter().copied()) {
            setup = MA_EXP.set(&setup, assignment)?;
        }
        let learned: Vec<Learned> =
            seeds.clone().map(|seed| learn(&setup, seed)).collect::<Result<_, _>>()?;
        let all = |number: fn(&Learned) -> f64| learned.iter().map(number).collect::<Vec<f64>>();
        let frozen = all(|it| it.frozen);
        let least = frozen.iter().copied().fold(f64::INFINITY, f64::min);
        let reached = |part: usize, factor: f64| {
            let told = |it: &Learned| it.reached.map(|reached| reached[part] * factor);
            let mut numbers: Vec<f64> =
                learned.iter().map(|it| told(it).unwrap_or(f64::INFINITY)).collect();
            numbers.sort_by(f64::total_cmp);
            numbers
        };
        let [steps, seconds] = [reached(0, 1e-3), reached(1, 1.0)];
        let middle = |numbers: &[f64]| numbers[numbers.len() / 2];
        let never = steps.iter().filter(|steps| steps.is_infinite()).count();
        println!(
            "| {name} | {} k | {} | {} (least {least:.2}) | {:.0} | {:.0} ({:.0} to {:.0}, never {never}) | {:.3} | {:.2} |",
            setup.run.steps / 1000,
            spread(&all(|it| it.last)),
            spread(&frozen),
            all(|it| it.length).iter().sum::<f64>() / learned.len() as f64,
            middle(&steps),
            steps[0],
            steps[steps.len() - 1],
            middle(&seconds),
            all(|it| it.seconds).iter().sum::<f64>() / learned.len() as f64,
        );
    }
    Ok(())
}
