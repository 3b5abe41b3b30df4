//! What is timed: both levels' steps and the roll-out of preset `paper`, on experience of its own.

use sortie_learn::Now;
use sortie_learn::play::Play;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::EpisodeCounts;
use sortie_methods::learners::windows::allocation::{AllocationLearning, AllocationLevel};
use sortie_methods::learners::windows::low_level::LowLevel;
use sortie_methods::learners::windows::{
    Config, Replay, SampleShape, WindowLearner, WindowShape, Windows, cut_windows, draw_episodes,
};
use sortie_nn::random::Generator;

use crate::bench::thread_cpu_s;
use crate::bench::train::setup;
use sortie_cli::failure::{Exit, Failure};
use sortie_cli::methods;

/// Environment steps into a run, for how much is tried out.
const TRIED_OUT_AT: u64 = 1_000_000;
/// Steps that teach the networks before anything is timed, so that targets differ from what learns.
const FIRST_STEPS: usize = 3;

/// One call: CPU-seconds and floating-point operations.
pub(super) struct Call {
    pub(super) cpu_s: f64,
    pub(super) operations: f64,
}

/// Both levels of a run, its roll-out, and a batch of it.
pub(super) struct Levels {
    pub(super) config: Config,
    pub(super) low_level: LowLevel,
    pub(super) allocation: AllocationLevel,
    pub(super) windows: Windows,
    pub(super) generator: Generator,
    /// Plays by the same networks.
    player: Player,
}

/// A method that plays rounds of episodes and learns nothing.
struct Player {
    method: WindowLearner,
    play: Play,
}

impl Player {
    fn new(config: &Config, seed: u64) -> Result<Self, Failure> {
        let environment = methods::open_environment(&config.environment)?;
        let mut method = WindowLearner::new(config, environment.spec(), seed, 1);
        let stream = |index| generator(seed, Purpose::Rollout, index as u64);
        let random = (0..config.environment.instances).map(stream).collect();
        let play = Play::new(&*environment, &mut method, random);
        Ok(Self { method, play })
    }

    /// One episode in every environment; environment steps.
    fn round(&mut self) -> Result<u64, Failure> {
        let now = Now { env_steps: TRIED_OUT_AT, of: TRIED_OUT_AT };
        Ok(self.play.round(&mut self.method, now, &mut EpisodeCounts::default())?)
    }
}

impl Levels {
    /// Plays by initial networks under rules that allocate, cuts a batch, and learns from it a little.
    pub(super) fn new(assignments: &[String], seed: u64) -> Result<Self, Failure> {
        let config = Config::of(&setup("paper", assignments)?)?;
        let environment = methods::open_environment(&config.environment)?;
        let sizes = WindowShape::of(environment.spec());
        let mut weights = generator(seed, Purpose::Weights, 0);
        let mut low_level = LowLevel::new(config.low_level.clone(), sizes, &mut weights);
        let mut allocation = AllocationLevel::new(AllocationLearning::of(&config, sizes), seed);
        let mut generator = generator(seed, Purpose::Replay, 0);
        let sample = SampleShape {
            windows: config.learning.windows,
            steps: config.learning.steps,
            ..SampleShape::default()
        };
        let replay = fill(&config, seed, sample.windows)?;
        let drawn = draw_episodes(&replay, sample.windows, &mut generator, |_| true)
            .ok_or_else(|| Failure::new(Exit::Bug, "too few episodes for a batch"))?;
        let windows = cut_windows(&*environment, &replay, &drawn, sample, &mut generator);
        let drawn_policy = allocation.policy.clone();
        for _ in 0..FIRST_STEPS {
            low_level.learn(&windows, 1, &mut generator);
            allocation.learn(&windows, 0, &mut generator, 1);
        }
        // From here on steps have no length, and the policy is as it was drawn: policies that learn
        // from one batch again and again propose the same, which saves work.
        low_level.config.learning_rate = 0.0;
        allocation.learning.learning_rate = 0.0;
        allocation.policy = drawn_policy;
        let learned = "learned".to_owned();
        let mut player = Player::new(&with_allocation(&config, &learned), seed)?;
        player.method.low_level = low_level.clone();
        player.method.allocation = Some(allocation.clone());
        Ok(Self { config, low_level, allocation, windows, generator, player })
    }

    /// Episodes of a round, which is also the number of steps that follow it.
    pub(super) fn episodes(&self) -> usize {
        self.config.environment.instances
    }

    /// One step of the low level.
    pub(super) fn low_level_step(&mut self) -> Call {
        let Self { low_level, windows, generator, .. } = self;
        let operations = low_level.operations();
        let start = thread_cpu_s();
        std::hint::black_box(low_level.learn(windows, 1, generator));
        let cpu_s = thread_cpu_s() - start;
        Call { cpu_s, operations: (low_level.operations() - operations) as f64 }
    }

    /// One step of proposal policy and critic.
    pub(super) fn allocation_step(&mut self) -> Call {
        let Self { allocation, windows, generator, .. } = self;
        let start = thread_cpu_s();
        let report = allocation.learn(windows, 0, generator, 1);
        let cpu_s = thread_cpu_s() - start;
        let operations = report.map_or(0, |report| report.operations) as f64;
        Call { cpu_s, operations }
    }

    /// One episode in every environment under the learned allocator: environment steps and CPU-seconds.
    pub(super) fn play(&mut self) -> Result<(f64, f64), Failure> {
        let start = thread_cpu_s();
        let steps = self.player.round()?;
        Ok((steps as f64, thread_cpu_s() - start))
    }
}

/// The same under another allocation.
fn with_allocation(config: &Config, by: &str) -> Config {
    let mut config = config.clone();
    config.allocation.by = by.to_owned();
    config
}

/// Plays so many episodes, in turns under the heuristic and under random allocations.
fn fill(config: &Config, seed: u64, episodes: usize) -> Result<Replay, Failure> {
    let mut player = Player::new(config, seed)?;
    for by in ["heuristic", "random"].into_iter().cycle() {
        if player.method.replay.steps.episodes() >= episodes {
            break;
        }
        player.method.config = with_allocation(config, by);
        player.round()?;
    }
    Ok(player.method.replay)
}
