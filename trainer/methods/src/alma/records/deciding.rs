//! Who works where while learning: allocations of an episode, explored, cut into segments.

use serde::{Deserialize, Serialize};
use sortie_envs::random::{below, chance, member, unit};
use sortie_envs::{DecisionPoints, Observation, Spec, UNASSIGNED, members};
use sortie_nn::random::Generator;

use super::config::{AllocatorConfig, Config, LEARNED};
use super::history::Reached;
use super::team_value::{Decision, Segment, Segments, TeamSearch};
use crate::alma::agents::UtilityNetwork;
use sortie_learn::LearnError;
use sortie_learn::subtasks::RuleAllocator;

/// The first rules of an environment stand in for an allocator that has not begun to decide, so many of them.
const STAND_INS: usize = 2;

/// Who allocates in an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "u8", into = "u8")]
pub(super) enum Allocation {
    /// The allocator of the run.
    Learned,
    /// The environment's rule of this number.
    Rule(u8),
}

impl Allocation {
    /// The rule that allocates, the first where none was asked for.
    fn rule(self) -> usize {
        match self {
            Self::Learned => 0,
            Self::Rule(number) => number.into(),
        }
    }
}

// As a number: what checkpoints say, also older ones.
impl From<u8> for Allocation {
    fn from(number: u8) -> Self {
        number.checked_sub(1).map_or(Self::Learned, Self::Rule)
    }
}

impl From<Allocation> for u8 {
    fn from(allocation: Allocation) -> Self {
        match allocation {
            Allocation::Learned => 0,
            Allocation::Rule(number) => number + 1,
        }
    }
}

/// What one episode remembers between its decisions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Decisions {
    allocation_by: Allocation,
    /// The rule that decides while the learned allocator learns but does not decide.
    stand_in: Allocation,
    points: DecisionPoints,
    tasks_changed: bool,
    pub(super) allocation: Vec<u8>,
    segment: Option<Segment>,
}

impl Decisions {
    pub(super) fn new(interval: u32, agents: usize) -> Self {
        Self {
            allocation_by: Allocation::Learned,
            stand_in: Allocation::Rule(0),
            points: DecisionPoints::every(interval),
            tasks_changed: false,
            allocation: vec![UNASSIGNED; agents],
            segment: None,
        }
    }

    /// A new episode begins.
    pub(super) fn restart(&mut self, deciding: &Deciding, generator: &mut Generator) {
        self.allocation_by = draw(&deciding.allocators, generator);
        self.stand_in = Allocation::Rule(below(generator, deciding.stand_ins) as u8);
        self.points.restart();
        self.tasks_changed = false;
        self.segment = None;
    }

    /// Notes what a step earned and whether it changed the open tasks.
    pub(super) fn reward(&mut self, discount: f32, task_rewards: &[f64], tasks_changed: bool) {
        self.tasks_changed = tasks_changed;
        if let Some(segment) = &mut self.segment {
            for (sum, reward) in segment.rewards.iter_mut().zip(task_rewards) {
                *sum += segment.discount * *reward as f32;
            }
            segment.discount *= discount;
        }
    }

    /// Ends the episode. After a time-out nobody decides, so that there is no next team to value.
    pub(super) fn end(&mut self, timed_out: bool, segments: Option<&mut Segments>) {
        if let (Some(segment), Some(segments), false) = (self.segment.take(), segments, timed_out) {
            segments.push(Segment { discount: 0.0, ..segment });
        }
    }

    /// Ends the segment of the decision before and begins that of the one just made.
    fn begin_segment(&mut self, (state, seen): (&[u8], &Observation), segments: &mut Segments) {
        let decision = Decision::new(state, &self.allocation[..seen.agents()]);
        if let Some(mut segment) = self.segment.take() {
            segment.next = decision.clone();
            segments.push(segment);
        }
        self.segment = Some(Segment {
            rewards: vec![0.0; seen.tasks()],
            discount: 1.0,
            next: decision.clone(),
            now: decision,
        });
    }
}

#[derive(Debug)]
pub(super) struct Deciding {
    /// Who allocates in a training episode, by weight.
    allocators: Vec<(Allocation, f64)>,
    /// Rules that stand in for the learned allocator.
    stand_ins: usize,
    /// Largest team that it sends to one subtask.
    team_max: usize,
    allocator: AllocatorConfig,
    search: TeamSearch,
}

impl Deciding {
    pub(super) fn new(config: &Config, spec: &Spec) -> Self {
        let (allocation, allocator) = (&config.allocation, config.allocator.clone());
        let search = TeamSearch::new(allocator.shape(spec), allocation.team_max);
        // Rules that the environment does not have are of no weight.
        let by_number = |(name, weight): (&str, f64)| {
            let rule =
                RuleAllocator(name).number(spec).map(|number| Allocation::Rule(number as u8));
            Some((if name == LEARNED { Allocation::Learned } else { rule.ok()? }, weight))
        };
        Self {
            allocators: allocation.weights().into_iter().filter_map(by_number).collect(),
            stand_ins: spec.rules.len().clamp(1, STAND_INS),
            team_max: allocation.team_max,
            allocator,
            search,
        }
    }

    /// Floating-point operations of the searches up to now.
    pub(super) fn operations(&self) -> u64 {
        self.search.operations()
    }

    /// Discount of the allocator's rewards per environment step.
    pub(super) fn discount(&self) -> f32 {
        self.allocator.discount
    }

    /// Decides if it is time to; returns whether it was.
    ///
    /// `network` decides where the learned allocator is to, or a rule in its stead. `segments` takes the
    /// segment that ends; without them the allocator learns nothing, and nothing is tried out.
    pub(super) fn decide(
        &mut self,
        episode: &mut Decisions,
        (now, seen): (Reached<'_>, &Observation),
        generator: &mut Generator,
        network: Option<&UtilityNetwork>,
        segments: Option<&mut Segments>,
    ) -> Result<bool, LearnError> {
        if !episode.points.is_due(episode.tasks_changed) {
            return Ok(false);
        }
        let learns = segments.is_some();
        let Reached { environment, state, .. } = now;
        let allocation = &mut episode.allocation;
        match (episode.allocation_by, network) {
            (Allocation::Learned, Some(network)) => {
                self.search.allocate(network, environment, state, generator, allocation)?;
            }
            (by, _) => {
                let by = if by == Allocation::Learned && learns { episode.stand_in } else { by };
                environment.allocate(by.rule(), state, generator, allocation);
            }
        }
        let explores = learns && episode.allocation_by == Allocation::Learned;
        if explores && chance(generator, self.allocator.moved_decisions) {
            move_some(seen, self.allocator.moved, self.team_max, generator, allocation);
        }
        if let Some(segments) = segments {
            episode.begin_segment((state, seen), segments);
        }
        Ok(true)
    }
}

/// Sends a share of the agents to random open subtasks, except where the team is full.
fn move_some(
    seen: &Observation,
    share: f64,
    team_max: usize,
    generator: &mut Generator,
    allocation: &mut [u8],
) {
    let open = seen.open_tasks;
    for agent in members(seen.acting().into()) {
        if chance(generator, share)
            && open != 0
            && let Some(task) = member(generator, open.into())
        {
            let task = task as u8;
            if allocation.iter().filter(|own| **own == task).count() < team_max {
                allocation[agent] = task;
            }
        }
    }
}

/// An allocator, drawn by its weight.
fn draw(weights: &[(Allocation, f64)], generator: &mut Generator) -> Allocation {
    let total: f64 = weights.iter().map(|(_, weight)| weight).sum();
    let mut left = unit(generator) * total;
    let drawn = weights.iter().find(|(_, weight)| {
        left -= weight;
        left < 0.0
    });
    // Rounding may leave something of the last weight.
    let last = || weights.iter().rev().find(|(_, weight)| *weight > 0.0);
    drawn.or_else(last).map_or(Allocation::Learned, |(allocation, _)| *allocation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::records::toy::{AGENTS, Street, toy};
    use sortie_envs::{Environment, Rule};
    use sortie_learn::random::{Purpose, generator};

    /// The rules of the toy: everybody to the last site, to the nearest, or to the first.
    const LAST: Allocation = Allocation::Rule(0);
    const NEAREST: Allocation = Allocation::Rule(1);

    fn deciding(change: fn(&mut Config)) -> Deciding {
        let mut config = Config::default();
        change(&mut config);
        Deciding::new(&config, toy().spec())
    }

    #[test]
    fn allocators_are_drawn_by_their_weights() {
        let deciding = deciding(|config| config.allocation.heuristic = 3.0);
        let mut random = generator(1, Purpose::Rollout, 0);
        let drawn: Vec<_> = (0..4000).map(|_| draw(&deciding.allocators, &mut random)).collect();
        let share = |who| drawn.iter().filter(|drawn| **drawn == who).count() as f64 / 4000.0;
        assert!((share(Allocation::Learned) - 0.25).abs() < 0.03);
        assert!((share(NEAREST) - 0.75).abs() < 0.03);
    }

    #[test]
    fn who_learns_decides_or_is_stood_in_for_and_nothing_else_is_tried_out() {
        let (environment, street) = (toy(), Street::new(6, &[3, 4, 14]));
        let (state, seen) = (street.bytes(), street.seen());
        let mut random = generator(1, Purpose::Rollout, 0);
        let mut by = |rule: Allocation| {
            let mut allocation = vec![UNASSIGNED; AGENTS];
            environment.allocate(rule.rule(), &state, &mut random, &mut allocation);
            allocation
        };
        let [last, nearest] = [LAST, NEAREST].map(&mut by);
        assert_ne!(last, nearest);
        let decided = |allocation_by, learns: bool, moved_decisions| {
            let mut config = Config::default();
            (config.allocator.moved, config.allocator.moved_decisions) = (1.0, moved_decisions);
            let stand_in = NEAREST;
            let mut episode = Decisions { allocation_by, stand_in, ..Decisions::new(5, AGENTS) };
            let (mut random, mut segments) = (generator(1, Purpose::Rollout, 0), Segments::new(10));
            let segments = learns.then_some(&mut segments);
            let now = (Reached { environment: &environment, state: &state, number: 0 }, &seen);
            let mut deciding = Deciding::new(&config, environment.spec());
            assert!(deciding.decide(&mut episode, now, &mut random, None, segments).unwrap());
            episode.allocation
        };
        assert_eq!(decided(Allocation::Learned, true, 0.0), nearest, "the episode's stand-in");
        assert_ne!(decided(Allocation::Learned, true, 1.0), nearest, "and agents are moved");
        assert_eq!(decided(Allocation::Learned, false, 1.0), last, "nobody learns");
        assert_eq!(decided(NEAREST, true, 1.0), nearest, "a rule is not explored");
    }

    #[test]
    fn an_episode_is_decided_by_whom_the_run_asks_for() {
        let by = |change| {
            let mut episode = Decisions::new(5, 1);
            episode.restart(&deciding(change), &mut generator(1, Purpose::Rollout, 0));
            episode.allocation_by
        };
        let heuristic = |config: &mut Config| {
            (config.allocation.learned, config.allocation.heuristic) = (0.0, 1.0);
        };
        assert_eq!(by(heuristic), NEAREST);
        assert_eq!(by(|config| config.allocation.rule = "coordinated".to_owned()), LAST);
    }

    /// The first two rules whatever they are called; of one rule that alone.
    #[test]
    fn the_first_rules_stand_in() {
        let stand_ins = |names: &'static [&'static str]| {
            let rules = names.iter().map(|name| Rule { name, about: "" }).collect::<Vec<_>>();
            let spec = Spec { rules: rules.leak(), ..toy().spec().clone() };
            let deciding = Deciding::new(&Config::default(), &spec);
            let mut episode = Decisions::new(5, 1);
            let mut random = generator(1, Purpose::Rollout, 0);
            let drawn = (0..50).map(|_| {
                episode.restart(&deciding, &mut random);
                assert_eq!(episode.allocation_by, Allocation::Learned);
                episode.stand_in.rule()
            });
            drawn.collect::<std::collections::BTreeSet<_>>()
        };
        assert!(stand_ins(&["dynamic", "matching", "random"]).into_iter().eq([0, 1]));
        assert!(stand_ins(&["dynamic"]).into_iter().eq([0]));
    }

    #[test]
    fn a_share_of_the_agents_moves_to_open_sites_with_room() {
        let mut random = generator(1, Purpose::Rollout, 0);
        // Of so many times eight agents who are all at the second site.
        let mut moved = |share, team_max, sites: &[(u8, bool)], times| {
            let seen = Street { sites: sites.to_vec(), ..Street::new(8, &[]) }.seen();
            let mut counts = [0; 3];
            for _ in 0..times {
                let mut allocation = vec![1; AGENTS];
                move_some(&seen, share, team_max, &mut random, &mut allocation);
                allocation.iter().for_each(|task| counts[usize::from(*task)] += 1);
            }
            counts
        };
        let sites = [(1, true), (5, false), (9, true)];
        assert_eq!(moved(0.0, 8, &sites, 1), [0, 8, 0]);
        assert_eq!(moved(1.0, 8, &sites[1..2], 1), [0, 8, 0], "nothing is open");
        assert_eq!(moved(1.0, 3, &sites, 1), [3, 2, 3], "a team of three is full");
        let [first, _, second]: [i32; 3] = moved(0.25, 8, &sites, 125);
        assert!(first.abs_diff(125) < 40 && second.abs_diff(125) < 40, "{first}, {second}");
    }

    #[test]
    fn rewards_of_a_segment_are_discounted_step_by_step() {
        let street = Street::new(1, &[3, 9]);
        let (state, seen) = (street.bytes(), street.seen());
        let now = (&state[..], &seen);
        let mut segments = Segments::new(10);
        let mut episode = Decisions::new(5, 1);
        episode.allocation = vec![1];
        episode.begin_segment(now, &mut segments);
        for (first, second) in [(1.0, 0.0), (2.0, 8.0), (4.0, 16.0)] {
            episode.reward(0.5, &[first, second], false);
        }
        episode.allocation = vec![0];
        episode.begin_segment(now, &mut segments);
        let segment = segments.get(0);
        assert_eq!(segment.rewards, [1.0 + 0.5 * 2.0 + 0.25 * 4.0, 0.5 * 8.0 + 0.25 * 16.0]);
        assert_eq!(segment.discount, 0.125);
        assert_eq!([&segment.now, &segment.next].map(|decision| decision.allocation[0]), [1, 0]);

        episode.reward(0.5, &[3.0, 5.0], true);
        episode.end(false, Some(&mut segments));
        let last = segments.get(1);
        assert_eq!((&last.rewards[..], last.discount), (&[3.0, 5.0][..], 0.0));
    }
}
