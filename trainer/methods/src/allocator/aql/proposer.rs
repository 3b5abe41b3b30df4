//! Allocations that are proposed, and the best of them; and what is learned from an episode: which proposals were best in its
//! states, and what the allocations of its steps were worth.

use sortie_envs::{Environment, Random, UNASSIGNED};
use sortie_learn::trajectory::Episode;
use sortie_learn::{LearnError, Trajectories};

use super::{CriticInput, CriticTarget};
use crate::allocator::deciding::{Asked, Group, Seen};
use crate::allocator::network::{Critic, Network};

/// Who proposes and who values, each with its weights.
#[derive(Clone, Copy)]
pub(super) struct Networks<'a> {
    pub(super) proposing: (&'a Network, &'a [f32]),
    pub(super) critic: (&'a Critic, &'a [f32]),
    pub(super) input: CriticInput,
}

/// What a critic looks at.
#[derive(Clone, Debug)]
pub(super) struct Situation {
    /// What is earned until there.
    pub(super) earned: f32,
    /// Nothing is earned from there on.
    pub(super) over: bool,
    pub(super) state: Vec<u8>,
    /// `[A]`: what was in force.
    pub(super) before: Vec<u8>,
    /// `[A]`: what was given there, [`UNASSIGNED`] before that.
    pub(super) given: Vec<u8>,
}

/// The best proposal in a state.
#[derive(Clone, Debug)]
pub(super) struct Best {
    pub(super) allocation: Vec<u8>,
    pub(super) situation: Situation,
}

/// Proposes allocations in the states of episodes that have the same subtasks, and has them valued.
pub(super) struct Proposer {
    pub(super) proposing: Group,
    valuing: Group,
    /// Where an allocation is tried.
    world: Box<dyn Environment>,
}

impl Proposer {
    pub(super) fn new(environment: &dyn Environment) -> Self {
        let world = environment.open(1, sortie_envs::Split::Train);
        Self { proposing: Group::default(), valuing: Group::default(), world }
    }

    /// Forgets what depends on weights.
    pub(super) fn forget(&mut self) {
        self.proposing.forget();
        self.valuing.forget();
    }

    /// What a critic looks at to value an allocation.
    pub(super) fn situation(
        &mut self,
        input: CriticInput,
        asked: &Asked<'_>,
        allocation: &[u8],
    ) -> Result<Situation, LearnError> {
        if input == CriticInput::Allocation {
            return Ok(Situation::of(asked, allocation.to_vec()));
        }
        let (world, mut random) = (&mut self.world, sortie_envs::random::generator(0));
        let mut actions = vec![0; allocation.len()];
        world.load(0, asked.state).map_err(LearnError::environment)?;
        world.scripted(asked.state, allocation, &mut random, &mut actions);
        let step = world.step(0, &actions, &mut random)?;
        let mut state = Vec::new();
        world.save(0, &mut state);
        Ok(Situation {
            earned: step.reward as f32,
            over: step.done(),
            state,
            before: allocation.to_vec(),
            given: vec![UNASSIGNED; allocation.len()],
        })
    }

    /// `[situations]`: what was earned until there, and what a critic expects of the rest.
    pub(super) fn values(
        &mut self,
        critic: (&Critic, &[f32]),
        situations: &[&Situation],
    ) -> Vec<f32> {
        let open = |situation: &&&Situation| !situation.over;
        let (asked, given): (Vec<_>, Vec<_>) =
            situations.iter().filter(open).map(|it| it.asked()).unzip();
        let mut values = Vec::new();
        if !asked.is_empty() {
            let seen = Seen { environment: &*self.world, turn: 0, states: &asked };
            self.valuing.look(seen, &given);
            values = self.valuing.values(critic);
        }
        let mut values = values.into_iter();
        let value = |it: &&Situation| {
            it.earned + if it.over { 0.0 } else { values.next().unwrap_or_default() }
        };
        situations.iter().map(value).collect()
    }

    /// The best of so many proposals in each state.
    pub(super) fn best(
        &mut self,
        networks: Networks<'_>,
        states: &[Asked<'_>],
        count: usize,
        random: &mut Random,
    ) -> Result<Vec<Best>, LearnError> {
        let seen = Seen { environment: &*self.world, turn: 0, states };
        let proposals = self.proposing.propose(networks.proposing, seen, (count, random));
        let mut proposed = Vec::new();
        for (asked, allocations) in states.iter().zip(proposals) {
            let of_state = allocations.into_iter().map(|allocation| {
                let situation = self.situation(networks.input, asked, &allocation)?;
                Ok(Best { allocation, situation })
            });
            proposed.push(of_state.collect::<Result<Vec<_>, LearnError>>()?);
        }
        let situations = proposed.iter().flatten().map(|proposal| &proposal.situation);
        let values = self.values(networks.critic, &situations.collect::<Vec<_>>());
        let mut values = values.into_iter();
        let best = |of_state: Vec<Best>| {
            let valued = of_state.into_iter().zip(&mut values);
            let best = valued.max_by(|one, other| one.1.total_cmp(&other.1));
            best.map(|(best, _)| best)
        };
        proposed
            .into_iter()
            .map(best)
            .collect::<Option<_>>()
            .ok_or_else(|| LearnError::Team("nothing was proposed".to_owned()))
    }
}

impl Situation {
    /// A state in which agents were given something, or are about to be.
    pub(super) fn of(asked: &Asked<'_>, given: Vec<u8>) -> Self {
        let (state, before) = (asked.state.to_vec(), asked.before.to_vec());
        Self { earned: 0.0, over: false, state, before, given }
    }

    pub(super) fn asked(&self) -> (Asked<'_>, Vec<u8>) {
        (Asked { episode: 0, state: &self.state, before: &self.before }, self.given.clone())
    }
}

/// An episode as both networks learn from it.
pub(super) struct Lesson {
    proposer: Proposer,
    /// Proposes once more what was best.
    pub(super) best: Group,
    /// The situations that the episode went through.
    pub(super) taken: Group,
    /// `[situations]`: what these are worth.
    pub(super) targets: Vec<f32>,
    pub(super) random: Random,
}

/// Who is asked about an episode.
#[derive(Clone, Copy)]
pub(super) struct Teachers<'a> {
    pub(super) networks: Networks<'a>,
    /// The weights by which the best proposals are valued.
    pub(super) target: &'a [f32],
    pub(super) learns: CriticTarget,
    pub(super) count: usize,
}

impl Lesson {
    pub(super) fn new(environment: &dyn Environment, random: Random) -> Self {
        let (best, taken) = (Group::default(), Group::default());
        Self { proposer: Proposer::new(environment), best, taken, targets: Vec::new(), random }
    }

    /// Looks at an episode, of whose steps the allocations were noted.
    pub(super) fn prepare(
        &mut self,
        environment: &dyn Environment,
        teachers: Teachers<'_>,
        (replay, episode): (&Trajectories<Vec<u8>>, Episode),
    ) -> Result<(), LearnError> {
        let Teachers { networks, count, .. } = teachers;
        let places = |step| episode.first.after(step);
        let nothing = vec![UNASSIGNED; environment.spec().shape.agents];
        let asked = |step: usize| Asked {
            episode: 0,
            state: replay.state(places(step)),
            before: if step == 0 { &nothing } else { replay.note(places(step - 1)) },
        };
        let states: Vec<Asked<'_>> = (0..episode.steps).map(asked).collect();
        self.proposer.forget();
        let best = self.proposer.best(networks, &states, count, &mut self.random)?;
        let allocations: Vec<Vec<u8>> = best.iter().map(|best| best.allocation.clone()).collect();
        let seen = Seen { environment, turn: 0, states: &states };
        self.best.follow(seen, &allocations);

        let rewards: Vec<f32> =
            (0..episode.steps).map(|step| replay.rewards(places(step)).team).collect();
        let ahead = self.ahead(teachers, &best, &rewards);
        let mut taken = Vec::new();
        self.targets.clear();
        for (step, reward) in rewards.iter().enumerate() {
            let given = replay.note(places(step)).clone();
            let (mut now, mut target) = (asked(step), reward + ahead[step]);
            let mut situation = Situation::of(&now, given);
            if networks.input == CriticInput::AfterState {
                if step + 1 == episode.steps {
                    break;
                }
                (now, target) = (asked(step + 1), ahead[step]);
                situation = Situation::of(&now, nothing.clone());
            }
            taken.push(situation);
            self.targets.push(target);
        }
        let (states, given): (Vec<_>, Vec<_>) = taken.iter().map(Situation::asked).unzip();
        self.taken.look(Seen { environment, turn: 0, states: &states }, &given);
        Ok(())
    }

    /// `[steps]`: what is earned after each step.
    fn ahead(&mut self, teachers: Teachers<'_>, best: &[Best], rewards: &[f32]) -> Vec<f32> {
        if teachers.learns == CriticTarget::Return {
            let mut ahead = vec![0.0; rewards.len()];
            for step in (1..rewards.len()).rev() {
                ahead[step - 1] = ahead[step] + rewards[step];
            }
            return ahead;
        }
        self.proposer.forget();
        let situations: Vec<&Situation> = best.iter().skip(1).map(|best| &best.situation).collect();
        let critic = (teachers.networks.critic.0, teachers.target);
        let mut ahead = self.proposer.values(critic, &situations);
        ahead.push(0.0);
        ahead
    }
}
