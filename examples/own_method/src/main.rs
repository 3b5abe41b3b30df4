//! A method of one's own: independent Q-learning (Tan 1993) of the parts that all methods share.

use std::error::Error;
use std::sync::atomic::AtomicBool;

use sortie_envs::random::generator;
use sortie_envs::{EntitySet, Environment, Observation, Random, Split};
use sortie_learn::learner::{Learner, Loss, Rules};
use sortie_learn::networks::{
    Acting, AgentShape, EntityAgent, EntityBatch, Greedy, LookShape, Targets, best,
};
use sortie_learn::run::{Rates, Reports, RunConfig, RunDescription};
use sortie_learn::session::{EnvironmentChoice, Session, Setup};
use sortie_learn::trajectory::{Capacity, Future, Place, Trajectories, Widths};
use sortie_learn::{Act, Ask, LearnError, Method, Now, State, Transition, play};
use sortie_nn::tape::Parameters;

const INSTANCES: usize = 16;
const RATES: Rates = Rates { epsilon: 0.2, learning_rate: 1e-3 };

/// Every agent learns what its actions are worth as if it were alone; all of them are one network.
struct Independent {
    agents: EntityAgent,
    learner: Learner<Vec<f32>>,
    replay: Trajectories,
    acting: Acting,
    random: Random,
}

impl Independent {
    fn new(environment: &dyn Environment) -> Self {
        let (shape, mut random) = (environment.spec().shape, generator(1));
        let looking = LookShape { input: shape.features, active_inputs: 3, width: 32, heads: 4 };
        let targets = Targets::of(environment.spec());
        let agent = AgentShape { looking, actions: shape.actions, skip: true, memory: 0, targets };
        let mut parameters = Parameters::default();
        let agents = EntityAgent::new(&mut parameters, agent, &mut random);
        let widths = Widths { agents: shape.agents, ..Widths::default() };
        let replay = Trajectories::new(Capacity::States(2_000), INSTANCES, widths);
        let learner = Learner::new(parameters, Rules::default(), 1);
        Self { agents, learner, replay, acting: Acting::default(), random }
    }

    /// What there is to see in some states.
    fn look<'a>(
        &self,
        environment: &dyn Environment,
        states: impl Iterator<Item = &'a [u8]>,
    ) -> EntityBatch {
        let (mut batch, mut seen) = (EntityBatch::default(), Observation::default());
        for state in states {
            environment.observe(state, 0, EntitySet::MAX, &mut seen);
            batch.push(&seen);
        }
        let targets = &self.agents.shape.targets;
        batch.aim_at(targets.entities(), targets.pairs());
        batch.finish(false);
        batch
    }
}

impl Method for Independent {
    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>, _: Now) -> Result<(), LearnError> {
        let teams = scenes.generators(random).map(|random| (RATES.epsilon, random));
        self.acting.look(scenes);
        self.acting.explore((&self.agents, &self.learner.online.values), teams, actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.replay.push(transition);
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        if now.env_steps < 1_000 {
            return Ok(Reports::default());
        }
        let drawn: Vec<Place> = (0..64).map(|_| self.replay.draw(1, &mut self.random)).collect();
        let future = |place: &Place| self.replay.future(*place, 1, 0.9);
        let futures: Vec<Future> = drawn.iter().map(future).collect();
        let before = drawn.iter().map(|place| self.replay.state(*place));
        let after = futures.iter().map(|future| self.replay.state(future.place));
        let [before, after] = [self.look(environment, before), self.look(environment, after)];
        let done = drawn.iter().flat_map(|place| self.replay.actions(*place));
        let done: Vec<u32> = done.map(|action| (*action).into()).collect();
        let agents = &self.agents;
        let report = self.learner.update(1, RATES.learning_rate, |shard| {
            let mut next = shard.spare.begin(shard.target);
            let utilities = agents.utilities(&mut next, &after, after.seen(), &mut []);
            let rows = next.values(utilities).chunks_exact(agents.shape.actions);
            let worth = rows.zip(after.available()).map(|(row, open)| row[best(row, *open)]);
            let of = futures.iter().flat_map(|future| std::iter::repeat_n(future, done.len() / 64));
            let target = |(future, worth): (&Future, f32)| future.reward + future.discount * worth;
            *shard.space = of.zip(worth).map(target).collect();
            let utilities = agents.utilities(&mut shard.pass, &before, before.seen(), &mut []);
            let chosen = shard.pass.pick(utilities, &done);
            let share = 1.0 / done.len() as f32;
            Loss::of(&mut shard.pass, |pass| pass.squared_error(chosen, shard.space, share))
        });
        Ok(Reports { agents: vec![report], ..Reports::default() })
    }

    fn rates(&self, _: Now) -> Rates {
        RATES
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(Greedy::new(&self.agents, &self.learner.average))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.learner.state(state)?;
        self.replay.visit(state)?;
        state.value("random", &mut self.random)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let ring = || sortie_envs::open("group-matching/3x6x1", Split::Train, 1, &Default::default());
    let environment = EnvironmentChoice::of(&*ring()?, INSTANCES);
    let run = RunConfig { steps: 30_000, final_episodes: 0, ..RunConfig::default() };
    let setup = Setup { method: "independent".into(), environment, run, ..Setup::default() };
    let method = Box::new(Independent::new(&*ring()?));
    let folder = std::env::temp_dir().join(format!("own-method-{}", std::process::id()));
    let mut session = Session::begin(RunDescription::new(setup, 1, 1), ring()?, method, &folder)?;
    session.run(&mut (), &AtomicBool::new(false))?;
    let chance = play::evaluate(&*ring()?, &mut play::RandomTeam::new(1), 500, 1)?.return_mean;
    let learned = play::evaluate(&*ring()?, &mut *session.method().team(), 500, 1)?.return_mean;
    println!("return: {chance:.2} at random, {learned:.2} learned");
    Ok(())
}
