//! Agents look at scenes and choose by their policies.

use sortie_envs::random::unit;
use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_learn::Scene;
use sortie_nn::layers::softmax;
use sortie_nn::tape::Tape;

use super::drawing::{best, drawn};
use super::groups::Groups;
use super::policies::Policies;
use super::running::Running;

/// What becomes of observations before networks are shown them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Inputs {
    /// Whether they are normalised.
    pub(crate) normalised: bool,
    /// What they are multiplied with if they are not.
    pub(crate) scale: f32,
}

/// What is seen in one state, all agents one behind the other, each as far as its role sees.
pub(crate) fn observe(
    environment: &dyn Environment,
    groups: &Groups,
    state: &[u8],
    seen: &mut Observation,
    numbers: &mut Vec<f32>,
) {
    environment.observe(state, 0, EntitySet::MAX, seen);
    for group in &groups.0 {
        for agent in group.agents.clone() {
            let start = numbers.len();
            numbers.resize(start + group.observed, 0.0);
            seen.rows.write_dense(agent, &mut numbers[start..]);
        }
    }
}

/// Numbers that all agents see together.
pub(crate) fn observed(groups: &Groups) -> usize {
    groups.0.iter().map(|group| group.observed * group.agents.len()).sum()
}

/// Adds, by groups, the rows that the networks are shown of what is seen in one state.
pub(crate) fn show(
    groups: &Groups,
    inputs: Inputs,
    mut observation: &[f32],
    shown: &mut [Vec<f32>],
) {
    let scale = if inputs.normalised { 1.0 } else { inputs.scale };
    for (group, shown) in groups.0.iter().zip(shown) {
        for index in 0..group.agents.len() {
            let (own, rest) = observation.split_at(group.observed);
            observation = rest;
            shown.extend(own.iter().map(|number| scale * number));
            if group.identity {
                let start = shown.len();
                shown.resize(start + group.agents.len(), 0.0);
                shown[start + index] = 1.0;
            }
        }
    }
}

/// Agents at work in several scenes.
#[derive(Debug, Default)]
pub(crate) struct Acting {
    seen: Observation,
    /// `[scenes, observed]`
    pub(crate) observations: Vec<f32>,
    /// By groups, `[scenes, agents, inputs]`.
    pub(crate) shown: Vec<Vec<f32>>,
    tape: Tape,
    /// By groups, `[scenes, agents, actions]`.
    pub(crate) scores: Vec<Vec<f32>>,
}

/// The policies that act.
#[derive(Clone, Copy)]
pub(crate) struct Actors<'a> {
    pub(crate) groups: &'a Groups,
    pub(crate) inputs: Inputs,
    pub(crate) policies: &'a Policies,
    /// Which of their heads.
    pub(crate) head: usize,
    pub(crate) weights: &'a [f32],
    pub(crate) running: &'a Running,
}

impl Acting {
    /// Finds the scores of all actions in scenes.
    pub(crate) fn look<'s>(
        &mut self,
        actors: Actors<'_>,
        environment: &dyn Environment,
        scenes: impl Iterator<Item = &'s Scene<'s>>,
    ) {
        let Actors { groups, inputs, .. } = actors;
        self.forget(groups);
        let width = observed(groups);
        let mut count = 0;
        for scene in scenes {
            observe(environment, groups, scene.state, &mut self.seen, &mut self.observations);
            let own = &self.observations[count * width..];
            show(groups, inputs, own, &mut self.shown);
            count += 1;
        }
        self.score(actors, count);
    }

    /// What an agent thinks of its actions by its own row alone, `[actions]`; none of an agent that there is not, or of
    /// a row that is too short.
    pub(crate) fn look_from(
        &mut self,
        actors: Actors<'_>,
        agent: usize,
        row: &[f32],
    ) -> Option<&[f32]> {
        let groups = actors.groups;
        let (index, group) =
            groups.0.iter().enumerate().find(|(_, group)| group.agents.contains(&agent))?;
        let own = row.get(..group.observed)?;
        self.forget(groups);
        for of in &groups.0 {
            for other in of.agents.clone() {
                let end = self.observations.len() + of.observed;
                self.observations.extend_from_slice(if other == agent { own } else { &[] });
                self.observations.resize(end, 0.0);
            }
        }
        show(groups, actors.inputs, &self.observations, &mut self.shown);
        self.score(actors, 1);
        let place = agent - group.agents.start;
        self.scores.get(index)?.get(place * group.actions..)?.get(..group.actions)
    }

    fn forget(&mut self, groups: &Groups) {
        self.observations.clear();
        self.shown.resize_with(groups.0.len(), Vec::new);
        self.shown.iter_mut().for_each(Vec::clear);
    }

    fn score(&mut self, actors: Actors<'_>, count: usize) {
        let Actors { groups, inputs, policies, head, weights, running } = actors;
        if inputs.normalised {
            let rows = self.shown.iter_mut().enumerate();
            rows.for_each(|(group, rows)| running.normalise(group, rows));
        }
        let mut pass = self.tape.begin(weights);
        let heads = head..head + 1;
        let scores = policies.scores_of(heads, &mut pass, groups, &self.shown, 0..count);
        self.scores.resize_with(scores.len(), Vec::new);
        for (scores, kept) in scores.into_iter().zip(&mut self.scores) {
            kept.clear();
            kept.extend_from_slice(pass.values(scores));
        }
    }

    /// Writes `[agents]` what agents choose in one of the scenes: drawn by their scores, or without a generator the best.
    pub(crate) fn choose(
        &mut self,
        groups: &Groups,
        scene: usize,
        mut random: Option<&mut Random>,
        actions: &mut [u16],
    ) {
        for (group, scores) in groups.0.iter().zip(&mut self.scores) {
            let row = group.agents.len() * group.actions;
            let rows = scores[scene * row..][..row].chunks_exact_mut(group.actions);
            for (scores, agent) in rows.zip(group.agents.clone()) {
                actions[agent] = match &mut random {
                    Some(random) => {
                        softmax::forward(scores);
                        drawn(scores, unit(random) as f32) as u16
                    }
                    None => best(scores) as u16,
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::Split;

    use super::*;

    #[test]
    fn agents_that_share_are_shown_what_they_see_and_which_they_are() {
        let world =
            sortie_envs::open("particle/rover-tower-4", Split::Train, 1, &Default::default());
        let world = world.unwrap();
        let groups = Groups::new(world.spec(), true, true);
        assert_eq!(groups.0.iter().map(|group| group.inputs()).collect::<Vec<_>>(), [13, 8]);
        let inputs = Inputs { normalised: false, scale: 2.0 };
        let observation: Vec<f32> = (1..=34).map(|number| number as f32).collect();
        let mut shown = vec![Vec::new(); 2];
        show(&groups, inputs, &observation, &mut shown);
        let second: Vec<f32> = (12..=22).map(|number| 2.0 * number as f32).collect();
        assert_eq!((shown[0].len(), &shown[0][13..24]), (26, &second[..]));
        assert_eq!((&shown[0][11..13], &shown[0][24..]), (&[1.0, 0.0][..], &[0.0, 1.0][..]));
        assert_eq!((shown[1].len(), &shown[1][14..]), (16, &[0.0, 1.0][..]));
        // Who is alone needs not be told.
        let alone = Groups::new(world.spec(), false, true);
        assert_eq!(alone.0.iter().map(|group| group.inputs()).collect::<Vec<_>>(), [11, 11, 6, 6]);
    }
}
