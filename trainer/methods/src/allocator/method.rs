//! Learning from whole episodes of the same start.

use sortie_envs::{Environment, Random, UNASSIGNED};
use sortie_learn::configuration::require;
use sortie_learn::export::{DeployedAgents, Words};
use sortie_learn::learner::{Loss, Rules};
use sortie_learn::networks::{chances, draw};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::subtasks::{AllocatedTeam, ScriptedAgents, Subtasks};
use sortie_learn::{Act, Ask, LearnError, Learner, Method, Now, State, Transition};
use sortie_nn::lanes::in_lanes;
use sortie_nn::tape::Pass;

use super::agents::HeadingAgents;
use super::deciding::{Asked, Group, Seen};
use super::greedy::Greedy;
use super::network::Network;
use super::{Config, scripted};

/// What episodes of a group differ by that earn the same but for rounding.
const LEAST_SPREAD: f32 = 1e-4;

/// An allocator, and the episodes that it learns from next.
#[derive(Debug)]
pub(super) struct Allocator {
    config: Config,
    agents: HeadingAgents,
    pub(super) network: Network,
    pub(super) learner: Learner<()>,
    pub(super) groups: Vec<Group>,
    /// Draws what each group is given.
    random: Vec<Random>,
    /// What the first of a group begins with, so that all of them begin alike.
    start: Random,
    /// `[instances, A]`: the allocations in force.
    in_force: Vec<u8>,
    /// What every episode earned.
    pub(super) returns: Vec<f32>,
    over: usize,
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
            in_force: vec![UNASSIGNED; instances * spec.shape.agents],
            returns: vec![0.0; instances],
            over: 0,
            threads,
            agents: HeadingAgents::new(spec),
            network,
            config,
        })
    }

    /// The allocator as it is measured.
    fn greedy(&self) -> Greedy<'_> {
        Greedy::new((&self.network, &self.learner.average))
    }

    /// How much better than its group's mean each episode was, in units of the group's spread: long routes count as much as
    /// short ones (Shao et al. 2024).
    pub(super) fn advantages(&self) -> Vec<f32> {
        let mut advantages = Vec::new();
        for group in self.returns.chunks_exact(self.config.baseline.samples) {
            let share = 1.0 / group.len() as f32;
            let mean = share * group.iter().sum::<f32>();
            let variance = share * group.iter().map(|earned| (earned - mean).powi(2)).sum::<f32>();
            let scale = 1.0 / variance.sqrt().max(LEAST_SPREAD);
            advantages.extend(group.iter().map(|earned| scale * (earned - mean)));
        }
        advantages
    }
}

/// What a group loses: `- advantage log chance - entropy H` of all its decisions, times a share of the whole loss.
pub(super) fn loss(
    pass: &mut Pass<'_>,
    network: &Network,
    group: &Group,
    advantages: &[f32],
    (entropy, share): (f32, f32),
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

    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>, _: Now) -> Result<(), LearnError> {
        let (environment, samples) = (scenes.environment, self.config.baseline.samples);
        let network = (&self.network, &*self.learner.online.values);
        let team = environment.spec().shape.agents;
        let groups = self.groups.iter_mut().zip(&mut self.random);
        let groups = groups.zip(self.in_force.chunks_exact_mut(samples * team));
        let mut lanes: Vec<_> = groups.map(|group| (group, Vec::new())).collect();
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(team)) {
            lanes[scene.instance / samples].1.push((scene, actions));
        }
        lanes.retain(|(_, scenes)| !scenes.is_empty());
        in_lanes(self.threads, &mut lanes, |_, (((group, random), in_force), scenes)| {
            let own = |instance: usize| instance % samples * team..(instance % samples + 1) * team;
            for (scene, _) in scenes.iter().filter(|(scene, _)| scene.begins) {
                in_force[own(scene.instance)].fill(UNASSIGNED);
            }
            let asked = scenes.iter().map(|(scene, _)| Asked {
                episode: scene.instance % samples,
                state: scene.state,
                before: &in_force[own(scene.instance)],
            });
            let asked: Vec<Asked<'_>> = asked.collect();
            let seen = Seen { environment, turn: 0, states: &asked };
            let given =
                group.allocate(network, seen, |scores, offered| draw(scores, offered, random));
            for ((scene, actions), allocation) in scenes.iter_mut().zip(given) {
                environment.scripted(scene.state, &allocation, random, actions);
                in_force[own(scene.instance)].copy_from_slice(&allocation);
            }
        });
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        self.returns[transition.instance] += transition.step.reward as f32;
        self.over += usize::from(transition.step.done());
        Ok(())
    }

    fn update(&mut self, _: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        let episodes = self.returns.len();
        if self.over < episodes {
            return Ok(Reports::default());
        }
        let advantages = self.advantages();
        let Self { config, network, learner, groups, .. } = self;
        let samples = config.baseline.samples;
        let rate = config.optimiser.learning_rate_at(now.env_steps, now.of);
        let (entropy, share) = (config.baseline.entropy, 1.0 / episodes as f32);
        let decisions = groups.iter().map(|group| group.made.len() as u64).sum();
        let report = learner.update(groups.len(), rate, |shard| {
            let own = &advantages[shard.number * samples..][..samples];
            let group = &groups[shard.number];
            loss(&mut shard.pass, network, group, own, (entropy, share))
        });
        groups.iter_mut().for_each(Group::forget);
        self.returns.fill(0.0);
        self.over = 0;
        Ok(Reports { agents: vec![report], decisions, ..Reports::default() })
    }

    fn rates(&self, now: Now) -> Rates {
        let learning_rate = self.config.optimiser.learning_rate_at(now.env_steps, now.of);
        Rates { epsilon: 0.0, learning_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(AllocatedTeam::new(Box::new(ScriptedAgents::new(0)), Box::new(self.greedy()), 1))
    }

    fn subtasks(&self) -> Option<Subtasks<'_>> {
        Some(scripted(self.greedy(), (&self.network, &self.learner.average)))
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        Ok(self.agents.deployed())
    }

    fn words(&self) -> Words {
        Words {
            agents: "Every agent heads for what it was given: its network is written down, not learned.".to_owned(),
            allocator: "An allocator points at a subtask for one agent after the other. It knows subtasks by what stays \
                as it is of them, which it encodes once an episode.\n\n"
                .to_owned(),
            ..Words::default()
        }
    }

    fn allocation(&self) -> &str {
        "learned"
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.learner.state_as(state, |part| format!("allocator/{part}"))?;
        state.value("allocator/random", &mut self.random)
    }
}
