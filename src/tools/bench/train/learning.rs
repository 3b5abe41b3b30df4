//! What is timed: both levels of a run of preset `fast`, on experience of its own.

use sortie_learn::Now;
use sortie_learn::play::Play;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::EpisodeCounts;
use sortie_methods::learners::records::team_value::{TeamSearch, TeamValueLoss};
use sortie_methods::learners::records::{
    Chunk, Config, Knowledge, Learner, Loss, Networks, Records,
};
use sortie_nn::random::Generator;

use super::{Case, Turn, setup};
use crate::bench::thread_cpu_s;
use sortie_cli::failure::{Exit, Failure};
use sortie_cli::methods;

/// Environment steps that fill the replays before anything is timed.
const FILL: u64 = 40_000;

#[derive(Clone, Copy)]
pub(super) enum Work {
    AgentsUpdate,
    Rollout,
    AllocatorUpdate,
    Search,
}

impl Work {
    /// The agents' update first: it is the one that a peer is measured on.
    pub(super) const ALL: [Self; 4] =
        [Self::AgentsUpdate, Self::Rollout, Self::AllocatorUpdate, Self::Search];
}

/// Two learners and their roll-out.
pub(super) struct Learning {
    pub(super) config: Config,
    /// Of the whole run.
    steps: u64,
    pub(super) method: Records,
    pub(super) picks: Generator,
    play: Play,
    search: TeamSearch,
    decision: usize,
}

impl Learning {
    /// Acts for a while by initial networks, exploring as a run does, under rules that allocate.
    pub(super) fn new(assignments: &[String], seed: u64) -> Result<Self, Failure> {
        let setup = setup("fast", assignments)?;
        let mut config = Config::of(&setup)?;
        // As much as is filled: the capacity of a whole run would only take memory.
        config.replay.capacity = 500_000;
        // Decisions are kept from the first on, and rules make them until all is filled.
        (config.allocator.learns_from, config.allocator.decides_from) = (0, FILL);
        let environment = methods::open_environment(&setup.environment)?;
        let mut method = Records::new(&config, &*environment, seed, 1);
        let stream = |index| generator(seed, Purpose::Rollout, index as u64);
        let random = (0..config.environment.instances).map(stream).collect();
        let mut learning = Self {
            play: Play::new(&*environment, &mut method, random),
            search: TeamSearch::new(
                config.allocator.shape(environment.spec()),
                config.allocation.team_max,
            ),
            picks: generator(seed, Purpose::Replay, 0),
            decision: 0,
            method,
            config,
            steps: setup.run.steps,
        };
        let instances = learning.config.environment.instances as u64;
        for step in 0..FILL / instances {
            learning.act(step * instances)?;
        }
        Ok(learning)
    }

    /// A step in every instance, so far into a run.
    fn act(&mut self, env_steps: u64) -> Result<(), Failure> {
        let now = Now { env_steps, of: self.steps };
        self.play.round(&mut self.method, now, &mut EpisodeCounts::default())?;
        Ok(())
    }

    /// Empty space for gradients of the agents' loss.
    pub(super) fn chunk(&self) -> Chunk {
        let Config { network, mixer, .. } = &self.config;
        Chunk::new(&self.method.agents.knowledge().online, network.subtask, mixer.reward_factor())
    }

    /// The case of a work, without figures yet.
    pub(super) fn case(&self, work: Work) -> Case {
        let (records, decisions) = (self.config.replay.batch, self.config.allocator.replay.batch);
        let (name, unit, units) = match work {
            Work::AgentsUpdate => (
                format!("agents' update, {records} records"),
                "thousand records per CPU-second",
                records,
            ),
            Work::Rollout => (
                "roll-out, learned allocation".to_string(),
                "thousand steps per CPU-second",
                self.config.environment.instances,
            ),
            Work::AllocatorUpdate => (
                format!("allocator's update, {decisions} decisions"),
                "thousand decisions per CPU-second",
                decisions,
            ),
            Work::Search => {
                ("allocator's search".to_string(), "thousand decisions per CPU-second", 1)
            }
        };
        let empty = Vec::new;
        Case {
            name,
            unit,
            units: units as f64,
            rates: empty(),
            mflop: empty(),
            gflop_per_cpu_s: empty(),
        }
    }

    /// Works for so many CPU-seconds.
    pub(super) fn turn(&mut self, work: Work, seconds: f64) -> Result<Turn, Failure> {
        let (rollout, search) = (self.method.rollout.operations(), self.search.operations());
        let mut turn = timed(seconds, || match work {
            Work::AgentsUpdate => {
                self.method.agents.pick(&mut self.picks);
                update(&mut self.method.agents, self.config.optimiser.learning_rate);
                Ok(())
            }
            Work::AllocatorUpdate => {
                let learner = self.method.allocator.as_mut().ok_or_else(no_allocator)?;
                learner.pick(&mut self.picks);
                update(learner, self.config.allocator.optimiser.learning_rate);
                Ok(())
            }
            Work::Rollout => self.act(u64::MAX),
            Work::Search => self.decide(),
        })?;
        turn.operations = match work {
            Work::AgentsUpdate => {
                let mut chunk = self.chunk();
                gradient(&mut self.method.agents, &mut chunk, &mut self.picks);
                chunk.operations() as f64 * turn.calls
            }
            Work::AllocatorUpdate => {
                let learner = self.method.allocator.as_mut().ok_or_else(no_allocator)?;
                let mut loss = TeamValueLoss::new(learner.average.shape());
                gradient(learner, &mut loss, &mut self.picks);
                loss.operations() as f64 * turn.calls
            }
            Work::Rollout => (self.method.rollout.operations() - rollout) as f64,
            Work::Search => (self.search.operations() - search) as f64,
        };
        Ok(turn)
    }

    /// Decides once more on a state in which it was decided before.
    fn decide(&mut self) -> Result<(), Failure> {
        let learner = self.method.allocator.as_ref().ok_or_else(no_allocator)?;
        let knowledge = learner.knowledge();
        self.decision = (self.decision + 1) % knowledge.replay.len();
        let state = &knowledge.replay.get(self.decision).now.state;
        let (environment, random) = (knowledge.experience().environment, &mut self.picks);
        let mut allocation = vec![0; environment.spec().shape.agents];
        self.search.allocate(&knowledge.online, environment, state, random, &mut allocation)?;
        std::hint::black_box(allocation);
        Ok(())
    }
}

fn no_allocator() -> Failure {
    Failure::new(
        Exit::Usage,
        "what is measured learns an allocator: `allocation.learned` above 0, subtasks",
    )
}

fn update<L: Loss>(learner: &mut Learner<L>, rate: f32) {
    learner.job()();
    std::hint::black_box(learner.follow(rate));
}

/// The mean squared error of a batch and its gradient, computed beside the learner.
pub(super) fn gradient<L: Loss>(
    learner: &mut Learner<L>,
    loss: &mut L,
    picks: &mut Generator,
) -> (f64, Vec<f32>) {
    learner.pick(picks);
    let knowledge = learner.knowledge();
    let Knowledge { online, target, .. } = &*knowledge;
    let (mut sum, mut error, mut terms) = (Vec::new(), 0.0, 0);
    for picks in knowledge.picks().chunks(L::CHUNK) {
        loss.learn(Networks { online, target }, knowledge.experience(), picks);
        sum.resize(loss.gradient().len(), 0.0);
        sum.iter_mut().zip(loss.gradient()).for_each(|(sum, part)| *sum += part);
        error += loss.squared_error();
        terms += loss.terms();
    }
    let count = terms.max(1) as f64;
    (error / count, sum.into_iter().map(|slope| slope / count as f32).collect())
}

/// Calls again and again for so many CPU-seconds of this thread.
pub(super) fn timed(
    seconds: f64,
    mut call: impl FnMut() -> Result<(), Failure>,
) -> Result<Turn, Failure> {
    let start = thread_cpu_s();
    let (mut calls, mut cpu_s) = (0.0, 0.0);
    while calls == 0.0 || cpu_s < seconds {
        call()?;
        calls += 1.0;
        cpu_s = thread_cpu_s() - start;
    }
    Ok(Turn { calls, cpu_s, operations: 0.0 })
}
