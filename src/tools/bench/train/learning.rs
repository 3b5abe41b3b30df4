//! What is timed: both levels of a run of preset `fast`, on experience of its own.

use sortie_envs::Environment;
use sortie_learn::Now;
use sortie_learn::play::Play;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::EpisodeCounts;
use sortie_learn::subtasks::ToAllocate;
use sortie_methods::learners::records::team_value::TeamSearch;
use sortie_methods::learners::records::{Allocator, Config, Moment, Records};
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
    pub(super) environment: Box<dyn Environment>,
    random: Generator,
    play: Play,
    search: TeamSearch,
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
            search: TeamSearch::new(config.allocation.team_max),
            random: generator(seed, Purpose::Replay, 2),
            method,
            environment,
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
        let (acted, searched) = (self.method.operations(), self.search.operations());
        let mut updates = 0;
        let mut turn = timed(seconds, || match work {
            Work::AgentsUpdate => {
                let rate = self.config.optimiser.learning_rate;
                std::hint::black_box(self.method.update_agents(&*self.environment, rate));
                updates += self.method.agents.spaces().map(|lesson| lesson.operations).sum::<u64>();
                Ok(())
            }
            Work::AllocatorUpdate => {
                let (config, environment) = (&self.config.allocator, &*self.environment);
                let allocator = self.method.allocator.as_mut().ok_or_else(no_allocator)?;
                let rate = config.optimiser.learning_rate;
                std::hint::black_box(allocator.update(config, environment, rate));
                updates += allocator.learner.spaces().map(|lesson| lesson.operations).sum::<u64>();
                Ok(())
            }
            Work::Rollout => self.act(u64::MAX),
            Work::Search => self.decide(),
        })?;
        turn.operations = match work {
            Work::AgentsUpdate | Work::AllocatorUpdate => updates as f64,
            Work::Rollout => (self.method.operations() - acted) as f64,
            Work::Search => (self.search.operations() - searched) as f64,
        };
        Ok(turn)
    }

    /// Decides once more on a state in which it was decided before.
    fn decide(&mut self) -> Result<(), Failure> {
        let Self { method, environment, random, search, .. } = self;
        let allocator: &Allocator = method.allocator.as_ref().ok_or_else(no_allocator)?;
        let agents = environment.spec().shape.agents;
        let place = allocator.segments.draw(1, random);
        let state = Moment::read(allocator.segments.state(place), agents).state;
        let (environment, allocation) = (&**environment, &mut vec![0; agents][..]);
        let to = ToAllocate { environment, state, random, allocation };
        search.allocate(allocator.online(), to)?;
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
