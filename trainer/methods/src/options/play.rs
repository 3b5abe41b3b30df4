//! Options at work: which milestone to go for, and how; what agents do that are learned from is kept, option by option.

use serde::{Deserialize, Serialize};
use sortie_core::options::{least_missed, view_of};
use sortie_envs::random::{below, chance, unit};
use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_learn::trajectory::Place;
use sortie_learn::{Act, Ask, LearnError, Scene, Scenes, State, Transition, words};

use super::replay::{Finished, NONE, Note, Replay};
use crate::pictures::{Network, Shown, Space, best};

/// What an instance is doing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Running {
    pub(crate) goal: u8,
    /// Steps that it has gone for it, the one that it is about to take included.
    pub(crate) steps: u8,
    /// The milestones that it could choose from.
    pub(crate) mask: u32,
    /// Whether it is over; who only acts sees that by the milestone or the steps.
    pub(crate) is_over: bool,
    /// What was seen in the option, by a hash; kept where play is varied.
    views: Vec<u32>,
    /// Goals that were missed since the last milestone, kept likewise.
    missed: Vec<u8>,
}

impl Running {
    /// How often a view was met in the option before.
    fn meets(&mut self, shown: &[u8]) -> usize {
        let view = view_of(shown);
        let before = self.views.iter().filter(|other| **other == view).count();
        self.views.push(view);
        before
    }

    /// Goals that were missed since the last milestone, that of the option that ends among them unless it reached one.
    fn missed_by_now(&mut self, reached: bool) -> Vec<u8> {
        if reached {
            return Vec::new();
        }
        self.missed.push(self.goal);
        std::mem::take(&mut self.missed)
    }

    /// Of a mask the goals that were missed least often since the last milestone.
    fn least_missed(&self, mask: u32) -> u32 {
        let missed =
            |goal: usize| self.missed.iter().filter(|it| usize::from(**it) == goal).count();
        least_missed(mask, missed)
    }
}

words! {
    /// Where the mask of milestones comes from.
    Mask {
        /// A classifier that learns from what options came to.
        Learned = "learned",
        /// The truth.
        Oracle = "oracle",
        /// All milestones, always.
        None = "none",
    }
}

/// Networks and weights that act.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Actors<'a> {
    /// Steps after which an option is over without a milestone.
    pub(crate) option_steps: u8,
    pub(crate) shown: &'a Shown,
    pub(crate) controller: (&'a Network, &'a [f32]),
    /// What goals are chosen by; agents of a single goal choose nothing.
    pub(crate) chooser: Option<Chooser<'a>>,
}

/// Networks, weights and rules by which goals are chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chooser<'a> {
    pub(crate) mask: Mask,
    /// Likelihood from which on a milestone counts as afforded.
    pub(crate) threshold: f32,
    /// Whether milestones that were never reached count as afforded.
    pub(crate) unreached: bool,
    pub(crate) meta: (&'a Network, &'a [f32]),
    pub(crate) classifier: (&'a Network, &'a [f32]),
    /// Milestones, as bits, that were ever reached, and those that the classifier knows both classes of.
    pub(crate) known: [u32; 2],
}

/// How much is tried out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chances<'a> {
    /// Of a random action.
    pub(crate) actions: f32,
    /// Of any milestone as a goal.
    pub(crate) goals: f32,
    /// Of a goal that is drawn from the mask.
    pub(crate) afforded: f32,
    /// How often each milestone was reached, where what was seldom reached is drawn more often.
    pub(crate) reached: &'a [u64],
    /// Whether what is met again is answered otherwise.
    pub(crate) varied: bool,
}

/// Agents at work in several instances.
#[derive(Debug, Default)]
pub(crate) struct Player {
    /// By the numbers of the instances.
    pub(crate) running: Vec<Running>,
    pub(crate) seen: Vec<Observation>,
    /// Bytes of what is seen in each instance.
    pub(crate) shown: Vec<Vec<u8>>,
    /// Whether what an instance is in has been looked at already.
    looked: Vec<bool>,
    space: Space,
}

impl Player {
    /// Writes an action for each scene.
    pub(crate) fn act(
        &mut self,
        actors: Actors<'_>,
        scenes: &Scenes<'_>,
        chances: Chances<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) {
        for scene in scenes.scenes {
            if scene.begins || !self.looked.get(scene.instance).is_some_and(|looked| *looked) {
                self.look(actors.shown, scenes.environment, scene);
            }
            self.looked[scene.instance] = false;
        }
        let over = |running: &Running| running.is_over || running.steps >= actors.option_steps;
        let deciding = scenes.scenes.iter().filter(|scene| {
            let reached = scenes.environment.milestone(scene.instance).is_some();
            scene.begins || reached || over(&self.running[scene.instance])
        });
        let deciding: Vec<&Scene<'_>> = deciding.collect();
        self.decide(actors, scenes.environment, &deciding, chances, random);
        let (choices, mut greedy) = (actors.controller.0.heads.actions, Vec::new());
        for (place, scene) in scenes.scenes.iter().enumerate() {
            self.running[scene.instance].steps += 1;
            let random = &mut random[scene.instance];
            if chance(random, chances.actions.into()) {
                actions[place] = below(random, choices) as u16;
            } else {
                greedy.push((place, scene.instance));
            }
        }
        let Self { running, shown, space, .. } = self;
        let states = greedy.iter().map(|(_, instance)| {
            let goal = running[*instance].goal;
            (&*shown[*instance], goal.into())
        });
        let values = space.values(actors.controller, actors.shown, states);
        for ((place, instance), values) in greedy.iter().zip(values.chunks_exact(choices)) {
            let met = if chances.varied { running[*instance].meets(&shown[*instance]) } else { 0 };
            actions[*place] = ranked(values, met % choices) as u16;
        }
    }

    /// Looks at what a scene shows.
    pub(crate) fn look(&mut self, shown: &Shown, environment: &dyn Environment, scene: &Scene<'_>) {
        let places = self.running.len().max(scene.instance + 1);
        self.running.resize_with(places, Running::default);
        self.seen.resize_with(places, Observation::default);
        self.shown.resize_with(places, Vec::new);
        self.looked.resize(places, false);
        self.looked[scene.instance] = true;
        let seen = &mut self.seen[scene.instance];
        environment.observe(scene.state, 0, EntitySet::MAX, seen);
        let bytes = &mut self.shown[scene.instance];
        bytes.resize(shown.bytes(), 0);
        shown.write(&seen.rows, bytes);
    }

    /// Chooses a goal for each of these scenes.
    fn decide(
        &mut self,
        actors: Actors<'_>,
        environment: &dyn Environment,
        scenes: &[&Scene<'_>],
        chances: Chances<'_>,
        random: &mut [Random],
    ) {
        let Some(chooser) = actors.chooser else {
            let begin = |scene: &&Scene<'_>| self.running[scene.instance] = Running::default();
            scenes.iter().for_each(begin);
            return;
        };
        let masks = self.masks(chooser, actors.shown, environment, scenes);
        let Self { running, shown, space, .. } = self;
        let states = scenes.iter().map(|scene| (&*shown[scene.instance], 0));
        let values = space.values(chooser.meta, actors.shown, states);
        let milestones = chooser.meta.0.heads.actions;
        for ((scene, mask), values) in scenes.iter().zip(masks).zip(values.chunks_exact(milestones))
        {
            let random = &mut random[scene.instance];
            let number = unit(random) as f32;
            let running = &mut running[scene.instance];
            let counts = chances.varied && !scene.begins;
            let reached = environment.milestone(scene.instance).is_some();
            let missed = if counts { running.missed_by_now(reached) } else { Vec::new() };
            *running = Running { missed, mask, ..Running::default() };
            let goal = if number < chances.goals {
                below(random, milestones)
            } else if number < chances.goals + chances.afforded {
                seldom(mask, milestones, chances.reached, random)
            } else {
                best(values, running.least_missed(mask))
            };
            running.goal = goal as u8;
        }
    }

    /// The milestones that can be chosen from in each scene; all where none could.
    fn masks(
        &mut self,
        chooser: Chooser<'_>,
        shown: &Shown,
        environment: &dyn Environment,
        scenes: &[&Scene<'_>],
    ) -> Vec<u32> {
        let milestones = chooser.classifier.0.heads.actions;
        let all = u32::MAX >> (32 - milestones);
        let masks: Vec<u32> = match chooser.mask {
            Mask::None => vec![all; scenes.len()],
            Mask::Oracle => {
                let truth = |scene: &&Scene<'_>| environment.affordances(scene.state);
                scenes.iter().map(|scene| truth(scene).unwrap_or(all)).collect()
            }
            Mask::Learned => {
                let Self { shown: states, space, .. } = self;
                let states = scenes.iter().map(|scene| (&*states[scene.instance], 0));
                let logits = space.values(chooser.classifier, shown, states);
                let least = (chooser.threshold / (1.0 - chooser.threshold)).ln();
                let mask = |logits| mask(logits, least, chooser.known, chooser.unreached);
                logits.chunks_exact(milestones).map(mask).collect()
            }
        };
        masks.into_iter().map(|mask| if mask == 0 { all } else { mask }).collect()
    }
}

/// The place of the largest number but so many.
fn ranked(values: &[f32], skipped: usize) -> usize {
    let mut rest = u32::MAX;
    (0..skipped).for_each(|_| rest &= !(1 << best(values, rest)));
    best(values, rest)
}

/// The milestones that a classifier affords: what was never reached it does not unless that is wanted, what has no
/// negatives yet it does.
fn mask(logits: &[f32], least: f32, [reached, known]: [u32; 2], unreached: bool) -> u32 {
    let likely = logits.iter().enumerate().filter(|(_, logit)| **logit > least);
    let likely = likely.fold(0, |set, (milestone, _)| set | 1 << milestone);
    let all = u32::MAX >> (32 - logits.len());
    (if unreached { all } else { reached }) & (likely | !known)
}

/// A milestone of a mask, those that were reached seldom more often than others.
fn seldom(mask: u32, milestones: usize, reached: &[u64], random: &mut Random) -> usize {
    let most = reached.iter().max().copied().unwrap_or(0);
    let weight = |milestone: usize| match mask >> milestone & 1 {
        1 => most - reached.get(milestone).copied().unwrap_or(most) + 1,
        _ => 0,
    };
    let mut left = below(random, (0..milestones).map(weight).sum::<u64>() as usize) as u64;
    (0..milestones)
        .find(|milestone| {
            let weight = weight(*milestone);
            let found = left < weight;
            left = left.saturating_sub(weight);
            found
        })
        .unwrap_or(0)
}

/// What masks say of a milestone beside the truth, over all choices of a goal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MaskCounts {
    /// Choices where it could be reached.
    pub afforded: u64,
    /// Those of them where the mask hides it.
    pub over_pruned: u64,
    /// Choices where it could not be reached.
    pub others: u64,
    /// Those of them where the mask lets it through.
    pub under_pruned: u64,
}

/// An agent that is measured.
#[derive(Debug)]
pub struct Measured<'a> {
    actors: Actors<'a>,
    chances: Chances<'static>,
    player: Player,
    /// By milestones: the masks that goals were chosen from so far, where the environment knows the truth. None of agents
    /// that choose no goals.
    pub masks: Vec<MaskCounts>,
}

impl<'a> Measured<'a> {
    pub(crate) fn new(actors: Actors<'a>, chances: Chances<'static>) -> Self {
        let milestones = actors.chooser.map_or(0, |chooser| chooser.meta.0.heads.actions);
        let masks = vec![MaskCounts::default(); milestones];
        Self { actors, chances, player: Player::default(), masks }
    }

    /// Holds the masks of the goals that were just chosen against the truth.
    fn count_masks(&mut self, scenes: &Scenes<'_>) {
        for scene in scenes.scenes {
            let running = &self.player.running[scene.instance];
            if running.steps != 1 || self.masks.is_empty() {
                continue;
            }
            let Some(truth) = scenes.environment.affordances(scene.state) else { return };
            for (milestone, counts) in self.masks.iter_mut().enumerate() {
                let is = |set: u32| u64::from(set >> milestone & 1);
                counts.afforded += is(truth);
                counts.over_pruned += is(truth & !running.mask);
                counts.others += is(!truth);
                counts.under_pruned += is(running.mask & !truth);
            }
        }
    }
}

impl Act for Measured<'_> {
    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>) -> Result<(), LearnError> {
        self.player.act(self.actors, scenes, self.chances, random, actions);
        self.count_masks(scenes);
        Ok(())
    }
}

/// Agents at work, and what is kept of what they did.
#[derive(Debug)]
pub(crate) struct Recorder {
    pub(crate) player: Player,
    pub(crate) replay: Replay,
    /// The first step of the running option of each instance.
    started: Vec<Option<Place>>,
    /// Milestones that the running episode of each instance has reached, as bits.
    met: Vec<u32>,
}

impl Recorder {
    pub(crate) fn new(instances: usize, replay: Replay) -> Self {
        let (started, met) = (vec![None; instances], vec![0; instances]);
        Self { player: Player::default(), replay, started, met }
    }

    /// Keeps a step, and the option that is over behind it, if one is.
    pub(crate) fn record(
        &mut self,
        transition: &Transition<'_>,
        shown: &Shown,
        option_steps: u8,
    ) -> Option<Finished> {
        let Transition { environment, instance, step, .. } = *transition;
        let reached = environment.milestone(instance).map_or(NONE, |milestone| milestone as u8);
        let running = self.player.running[instance].clone();
        let before = self.player.seen[instance].rows.clone();
        let state = std::mem::take(&mut self.player.shown[instance]);
        let scene = Scene { instance, state: transition.next, begins: false, tasks_changed: false };
        self.player.look(shown, environment, &scene);
        let over = running.steps >= option_steps;
        let ends_option = reached != NONE || over || step.done();
        let milestone = 1_u32.checked_shl(reached.into()).unwrap_or(0);
        let note = Note {
            goal: running.goal,
            reached,
            is_first: milestone & !self.met[instance] != 0,
            option_reached: NONE,
            changed_nothing: reached == NONE && before == self.player.seen[instance].rows,
            ends_option,
        };
        self.met[instance] = if step.done() { 0 } else { self.met[instance] | milestone };
        // States are kept as networks are shown them.
        let next = &self.player.shown[instance];
        let place = self.replay.push(&Transition { state: &state, next, ..*transition }, note);
        let start = *self.started[instance].get_or_insert(place);
        if !ends_option {
            return None;
        }
        self.started[instance] = None;
        self.player.running[instance].is_over = true;
        let (Running { goal, steps, mask, .. }, end) = (running, self.replay.steps.end(place));
        let option = Finished { start, steps, goal, reached, mask, end };
        self.replay.finish(option);
        Some(option)
    }

    pub(crate) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.replay.state(state)?;
        state.value("running", &mut self.player.running)?;
        state.value("started", &mut self.started)?;
        state.value("met", &mut self.met)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_hold_what_is_likely_and_what_nothing_speaks_against() {
        let logits = [3.0, -3.0, 3.0, -3.0, 0.1];
        assert_eq!(mask(&logits, 0.0, [0b11110, 0b10110], false), 0b11100);
        assert_eq!(mask(&logits, 0.0, [0b11110, 0b10110], true), 0b11101);
        assert_eq!(mask(&logits, 0.2, [0b11111, 0b11111], false), 0b00101);
    }

    #[test]
    fn what_is_met_again_is_answered_by_the_next_best() {
        let values = [0.5, 2.0, -1.0, 2.0];
        assert_eq!([0, 1, 2, 3].map(|skipped| ranked(&values, skipped)), [1, 3, 0, 2]);
        let mut running = Running { missed: vec![0, 2, 0], ..Running::default() };
        assert_eq!(running.least_missed(0b0101), 0b0100);
        assert_eq!(running.least_missed(0b1111), 0b1010);
        let met = [&[1, 2][..], &[2, 1], &[1, 2], &[1, 2]].map(|view| running.meets(view));
        assert_eq!(met, [0, 0, 1, 2]);
    }

    #[test]
    fn goals_are_missed_until_a_milestone_is_reached() {
        let running = Running { goal: 3, missed: vec![1, 3], ..Running::default() };
        assert_eq!(running.clone().missed_by_now(false), [1, 3, 3]);
        assert_eq!(running.clone().missed_by_now(true), [0; 0]);
    }

    #[test]
    fn what_was_seldom_reached_is_drawn_more_often() {
        let mut random = sortie_envs::random::generator(1);
        let mut drawn = [0; 4];
        (0..10_000).for_each(|_| drawn[seldom(0b1101, 4, &[9, 0, 4, 7], &mut random)] += 1);
        // Of weights 1, 6 and 3.
        for (found, want) in drawn.into_iter().zip([1_000_i32, 0, 6_000, 3_000]) {
            assert!((found - want).abs() < 200, "{drawn:?}");
        }
        drawn = [0; 4];
        (0..10_000).for_each(|_| drawn[seldom(0b1010, 4, &[], &mut random)] += 1);
        assert!(drawn[0] == 0 && drawn[2] == 0 && drawn[1].abs_diff(5_000) < 200, "{drawn:?}");
    }
}
