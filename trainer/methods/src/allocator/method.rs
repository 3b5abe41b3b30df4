//! Learning from whole episodes of the same start.

use sortie_envs::{Environment, Random};
use sortie_learn::learner::{Loss, Rules};
use sortie_learn::networks::best;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::configuration::require;
use sortie_learn::subtasks::{
    Allocate, AllocatedTeam, ScriptedAgents,
};
use sortie_learn::{Act, LearnError, Learner, Method, Now, Scenes, State, Transition};
use sortie_nn::lanes::in_lanes;
use sortie_nn::tape::Pass;

use super::Config;
use super::deciding::{Group, chances, draw};
use super::network::Network;

/// How fast the spread of what episodes earn is followed.
const SPREAD_RATE: f32 = 0.05;

/// An allocator, and the episodes that it learns from next.
#[derive(Debug)]
pub(super) struct Allocator {
    config: Config,
    network: Network,
    learner: Learner<()>,
    groups: Vec<Group>,
    /// Draws what each group is given.
    random: Vec<Random>,
    /// What the first of a group begins with, so that all of them begin alike.
    start: Random,
    /// What every episode earned.
    returns: Vec<f32>,
    over: usize,
    /// Mean square of how much better than their baseline episodes are.
    spread: f32,
    threads: usize,
}

impl Allocator {
    /// Draws the first weights.
    ///
    /// # Errors
    /// Sizes do not fit each other.
    pub(super) fn new(config: Config, opening: &Opening<'_>) -> Result<Self, LearnError> {
        let Opening { setup, environment, seed, threads } = *opening;
        let (spec, instances) = (environment.spec(), setup.environment.instances);
        let samples = config.baseline.samples;
        require(
            instances.is_multiple_of(samples),
            "`environment.instances` must be a multiple of `baseline.samples`",
        )?;
        let columns = [spec.fixed, spec.shape.features];
        let drawn = &mut generator(seed, Purpose::Weights, 0);
        let (network, weights) = Network::new(&config.network, columns, drawn)?;
        let groups = instances / samples;
        let random = |group| generator(seed, Purpose::Proposals, group as u64);
        Ok(Self {
            learner: Learner::new(weights, Rules::from(&config.optimiser), threads),
            groups: (0..groups).map(|_| Group::default()).collect(),
            random: (0..groups).map(random).collect(),
            start: generator(seed, Purpose::Proposals, u64::MAX),
            returns: vec![0.0; instances],
            over: 0,
            spread: 0.0,
            threads,
            network,
            config,
        })
    }

    /// How much better than its group's others each episode was, in units of what is usual.
    fn advantages(&mut self) -> Vec<f32> {
        let samples = self.config.baseline.samples;
        let mut advantages = Vec::new();
        for group in self.returns.chunks_exact(samples) {
            let mean = group.iter().sum::<f32>() / samples as f32;
            // Of the others alone, by the mean of all.
            let others = samples as f32 / (samples - 1) as f32;
            advantages.extend(group.iter().map(|earned| (earned - mean) * others));
        }
        let square = advantages.iter().map(|it| it * it).sum::<f32>() / advantages.len() as f32;
        let rate = if self.spread == 0.0 { 1.0 } else { SPREAD_RATE };
        self.spread += rate * (square - self.spread);
        let scale = 1.0 / self.spread.sqrt().max(1e-6);
        advantages.iter_mut().for_each(|advantage| *advantage *= scale);
        advantages
    }
}

/// What a group loses: `- advantage log chance - entropy` of its decisions, of so many episodes in all.
fn loss(
    pass: &mut Pass<'_>,
    network: &Network,
    group: &Group,
    advantages: &[f32],
    entropy: f32,
    share: f32,
) -> Loss {
    let made = &group.made;
    let tables = network.encode(pass, &group.subtasks.rows);
    let scores = network.scores(pass, tables, made);
    let columns = pass.size(scores)[1];
    let mut slopes = Vec::with_capacity(made.len() * columns);
    let mut reported = 0.0;
    for (decision, scores) in pass.values(scores).chunks_exact(columns).enumerate() {
        let chances = chances(scores, made.offered[decision]);
        let logarithm = |chance: f32| if chance > 0.0 { chance.ln() } else { 0.0 };
        let disorder: f32 = chances.iter().map(|chance| -chance * logarithm(*chance)).sum();
        let (advantage, chosen) = (advantages[made.episodes[decision]], made.chosen[decision]);
        for (place, chance) in chances.iter().enumerate() {
            let better = chance - f32::from(u8::from(place == chosen));
            let disorderly = chance * (logarithm(*chance) + disorder);
            slopes.push(share * (advantage * better + entropy * disorderly));
        }
        reported -= share * (advantage * logarithm(chances[chosen]) + entropy * disorder);
    }
    Loss { total: pass.weighted_sum(scores, &slopes), reported: reported.into() }
}

/// An allocator that gives the best that it knows.
struct Greedy<'a> {
    network: (&'a Network, &'a [f32]),
    group: Group,
}

impl Allocate for Greedy<'_> {
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        _: &mut Random,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        self.group.made.clear();
        let found =
            self.group.allocate(self.network, environment, &[(0, state)], |scores, offered| {
                best(scores, offered.into())
            });
        allocation.copy_from_slice(&found[0]);
        Ok(())
    }
}

impl Method for Allocator {
    fn waits(&self) -> bool {
        true
    }

    /// All of a group have the same start.
    fn begins(&mut self, instance: usize, random: &mut Random) {
        if instance.is_multiple_of(self.config.baseline.samples) {
            self.start = random.clone();
        }
        *random = self.start.clone();
    }

    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: Now,
        _: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let (environment, samples) = (scenes.environment, self.config.baseline.samples);
        let network = (&self.network, &*self.learner.online.values);
        let team = environment.spec().shape.agents;
        let mut actions = actions.chunks_exact_mut(team);
        let groups = scenes.scenes.chunk_by(|one, next| one.instance / samples == next.instance / samples);
        let mut lanes: Vec<_> = Vec::new();
        let mut own = self.groups.iter_mut().zip(&mut self.random).enumerate();
        for scenes in groups {
            let number = scenes[0].instance / samples;
            let (_, lane) = own.find(|(group, _)| *group == number).expect("a group of each scene");
            let actions: Vec<&mut [u16]> = actions.by_ref().take(scenes.len()).collect();
            lanes.push((scenes, lane, actions));
        }
        in_lanes(self.threads, &mut lanes, |_, (scenes, (group, random), actions)| {
            let states: Vec<(usize, &[u8])> =
                scenes.iter().map(|scene| (scene.instance % samples, scene.state)).collect();
            let given = group.allocate(network, environment, &states, |scores, offered| {
                draw(scores, offered, random)
            });
            for (((_, state), allocation), actions) in states.iter().zip(given).zip(actions) {
                environment.scripted(state, &allocation, random, actions);
            }
        });
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.returns[transition.instance] += transition.step.reward as f32;
        self.over += usize::from(transition.step.done());
        Ok(())
    }

    fn update(
        &mut self,
        _: &dyn Environment,
        now: Now,
        reports: &mut Reports,
    ) -> Result<(), LearnError> {
        let episodes = self.returns.len();
        if self.over < episodes {
            return Ok(());
        }
        let advantages = self.advantages();
        let Self { config, network, learner, groups, .. } = self;
        let samples = config.baseline.samples;
        let rate = config.optimiser.learning_rate_at(now.env_steps, now.of);
        let (entropy, share) = (config.baseline.entropy, 1.0 / episodes as f32);
        reports.decisions += groups.iter().map(|group| group.made.len() as u64).sum::<u64>();
        reports.agents.push(learner.update(groups.len(), rate, |shard| {
            let own = &advantages[shard.number * samples..][..samples];
            let group = &groups[shard.number];
            loss(&mut shard.pass, network, group, own, entropy, share)
        }));
        groups.iter_mut().for_each(Group::forget);
        self.returns.fill(0.0);
        self.over = 0;
        Ok(())
    }

    fn rates(&self, now: Now) -> Rates {
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        Rates { epsilon: 0.0, learning_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        let network = (&self.network, &*self.learner.average);
        let allocator = Greedy { network, group: Group::default() };
        Box::new(AllocatedTeam::new(Box::new(ScriptedAgents::new(0)), Box::new(allocator), 1))
    }

    fn allocation(&self) -> &str {
        "learned"
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.learner.state_as(state, |part| format!("allocator/{part}"))?;
        state.value("allocator/random", &mut self.random)?;
        state.value("allocator/spread", &mut self.spread)
    }
}
