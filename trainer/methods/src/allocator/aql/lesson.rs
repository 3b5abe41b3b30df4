//! What is learned from an episode: which proposals were best in its states, and what the allocations of its steps were worth.

use sortie_envs::{Environment, Random, UNASSIGNED};
use sortie_learn::trajectory::Episode;
use sortie_learn::{LearnError, Trajectories};

use super::proposer::{Best, Networks, Proposer, Situation};
use super::{CriticInput, CriticTarget};
use crate::allocator::deciding::{Asked, Group, Seen};

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
