//! SARSA on decisions, one target per open subtask; what was decided and what it earned, up to the next decision, is a
//! segment.
//!
//! `y = discounted task rewards of the segment + discount * f_target(next state, subtask, its next team)`,
//! the next team being the one really sent next. A subtask that is closed by then adds nothing. Loss:
//! squared difference. A drawn segment counts for one of the subtasks that were open, drawn as well:
//! the subtasks of one decision have much in common, and teach less together than those of several.

use serde::{Deserialize, Serialize};
use sortie_envs::{Environment, Observation, members};

use super::input::{TeamQuery, TeamValueInput};
use crate::alma::agents::{UtilityNetwork, UtilityPass, UtilityShape};
use crate::alma::records::learner::{Experience, Loss, Networks, Pick, Samples};

/// A state with the allocation that was made in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// The state.
    pub state: Vec<u8>,
    /// The subtask of every agent `[A]`.
    pub allocation: Vec<u8>,
}

impl Decision {
    /// What was decided for the agents that exist in a state.
    pub fn new(state: &[u8], allocation: &[u8]) -> Self {
        Self { state: state.to_vec(), allocation: allocation.to_vec() }
    }

    /// The agents at a subtask, as bits.
    pub fn team(&self, task: usize) -> u64 {
        let members = self.allocation.iter().enumerate();
        members.filter(|(_, own)| usize::from(**own) == task).map(|(agent, _)| 1 << agent).sum()
    }
}

/// The steps from one decision to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// What was decided.
    pub now: Decision,
    /// Discounted sum `[T]` of each task's rewards in between.
    pub rewards: Vec<f32>,
    /// Discount of what follows, a power of the discount of a step; 0 where the episode ended.
    pub discount: f32,
    /// What was decided then; `now` once more where the episode ended.
    pub next: Decision,
}

impl Segment {
    /// Whether its parts are of the same episode, as they should be.
    fn fits(&self) -> bool {
        let sizes = |decision: &Decision| (decision.state.len(), decision.allocation.len());
        sizes(&self.now) == sizes(&self.next)
    }
}

/// A ring of segments: the newest replaces the oldest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segments {
    capacity: usize,
    segments: Vec<Segment>,
    next: usize,
}

impl Segments {
    /// Room for `capacity` segments, at least one.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), segments: Vec::new(), next: 0 }
    }

    /// Stores a segment.
    pub fn push(&mut self, segment: Segment) {
        match self.segments.get_mut(self.next) {
            Some(place) => *place = segment,
            None => self.segments.push(segment),
        }
        self.next = (self.next + 1) % self.capacity;
    }

    /// Number of segments.
    pub fn len(&self) -> usize {
        self.segments.len()
    }

    /// Whether there is no segment.
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// A segment.
    pub fn get(&self, index: usize) -> &Segment {
        &self.segments[index]
    }

    /// Reads a little of the states of each of these segments, so that all are on their way from memory at the same time.
    pub(super) fn fetch(&self, indices: impl Iterator<Item = usize>) {
        let first = |decision: &Decision| decision.state.first().copied().unwrap_or(0);
        let read = indices
            .map(|index| first(&self.segments[index].now) ^ first(&self.segments[index].next));
        // What was read is not needed, which the compiler must not know.
        std::hint::black_box(read.fold(0, |sum, read| sum ^ read));
    }

    /// Whether this is a ring of that size whose parts fit together, as one from a file should be.
    pub fn fits(&self, capacity: usize) -> bool {
        self.capacity == capacity
            && self.segments.len() <= capacity
            && self.next < capacity
            && self.segments.iter().all(Segment::fits)
    }
}

impl Samples for Segments {
    fn count(&self) -> usize {
        self.len()
    }
}

/// A segment, one of the subtasks that were open when it began, and how it is turned.
#[derive(Clone, Copy, Debug)]
struct Picked<'a> {
    segment: &'a Segment,
    task: usize,
    turn: usize,
    /// Whether the episode and the subtask are still open at the next decision.
    goes_on: bool,
}

impl<'a> Picked<'a> {
    /// The draw decides on the subtask. `None` where none was open.
    fn new(
        experience: Experience<'a, Segments>,
        pick: &Pick,
        seen: &mut Observation,
    ) -> Option<Self> {
        let Experience { environment, replay } = experience;
        let segment = replay.get(pick.sample as usize);
        environment.observe(&segment.now.state, 0, 0, seen);
        let open = seen.open_tasks;
        let place = (pick.draw as usize).checked_rem(open.count_ones() as usize)?;
        let task = members(open.into()).nth(place)?;
        let mut goes_on = segment.discount > 0.0;
        if goes_on {
            environment.observe(&segment.next.state, 0, 0, seen);
            goes_on = seen.open_tasks >> task & 1 == 1;
        }
        Some(Self { segment, task, turn: pick.symmetry.into(), goes_on })
    }

    fn query(&self, decision: &'a Decision) -> TeamQuery<'a> {
        let Self { task, turn, .. } = *self;
        TeamQuery { state: &decision.state, task, team: decision.team(task), turn }
    }
}

/// Space to compute the gradient of some segments, and the result.
#[derive(Clone, Debug)]
pub struct TeamValueLoss {
    pass: UtilityPass,
    input: TeamValueInput,
    seen: Observation,
    targets: Vec<f32>,
    slopes: Vec<f32>,
    gradient: Vec<f32>,
    squared_error: f64,
}

impl TeamValueLoss {
    /// Empty space for networks of a shape.
    pub fn new(shape: UtilityShape) -> Self {
        Self {
            pass: UtilityPass::new(shape),
            input: TeamValueInput::default(),
            seen: Observation::default(),
            targets: Vec::new(),
            slopes: Vec::new(),
            gradient: vec![0.0; shape.parameters()],
            squared_error: 0.0,
        }
    }

    /// Floating-point operations up to now, as [`UtilityPass::operations`] counts them.
    pub fn operations(&self) -> u64 {
        self.pass.operations()
    }

    /// Computes the gradient of the summed squared differences to the targets.
    fn descend(
        &mut self,
        online: &UtilityNetwork,
        environment: &dyn Environment,
        picks: &[Picked<'_>],
    ) {
        let queries = picks.iter().map(|picked| picked.query(&picked.segment.now));
        let values = self.pass.forward(online, self.input.queries(environment, queries));
        self.slopes.clear();
        self.squared_error = 0.0;
        for (value, target) in values.iter().zip(&self.targets) {
            let error = value - target;
            self.squared_error += f64::from(error) * f64::from(error);
            self.slopes.push(2.0 * error);
        }
        self.gradient.fill(0.0);
        let input = self.input.input();
        self.pass.backward(online, input, &self.slopes, &mut self.gradient);
    }

    /// Writes the target of every picked subtask.
    fn find_targets(
        &mut self,
        target: &UtilityNetwork,
        environment: &dyn Environment,
        picks: &[Picked<'_>],
    ) {
        self.targets.clear();
        self.targets.extend(picks.iter().map(|picked| picked.segment.rewards[picked.task]));
        let followed = || picks.iter().zip(0..).filter(|(picked, _)| picked.goes_on);
        let queries = followed().map(|(picked, _)| picked.query(&picked.segment.next));
        let values = self.pass.forward(target, self.input.queries(environment, queries));
        for ((picked, number), value) in followed().zip(values) {
            self.targets[number as usize] += picked.segment.discount * value;
        }
    }
}

impl Loss for TeamValueLoss {
    type Network = UtilityNetwork;
    type Replay = Segments;
    const CHUNK: usize = 64;

    fn learn(
        &mut self,
        networks: Networks<'_, UtilityNetwork>,
        experience: Experience<'_, Segments>,
        picks: &[Pick],
    ) {
        experience.replay.fetch(picks.iter().map(|pick| pick.sample as usize));
        let picked = |pick| Picked::new(experience, pick, &mut self.seen);
        let picks: Vec<Picked<'_>> = picks.iter().filter_map(picked).collect();
        self.find_targets(networks.target, experience.environment, &picks);
        self.descend(networks.online, experience.environment, &picks);
    }

    fn squared_error(&self) -> f64 {
        self.squared_error
    }

    fn terms(&self) -> usize {
        self.targets.len()
    }

    fn gradient(&self) -> &[f32] {
        &self.gradient
    }
}

#[cfg(test)]
mod tests {
    use sortie_learn::random::{Purpose, generator};
    use sortie_nn::gradient_check::assert_gradient;

    use super::*;
    use crate::alma::records::config::{AllocatorConfig, NetworkConfig};
    use crate::alma::records::toy::{Street, toy};

    #[test]
    fn the_newest_segment_replaces_the_oldest() {
        let segment = |reward| Segment {
            now: Decision::default(),
            rewards: vec![reward],
            discount: 0.9,
            next: Decision::default(),
        };
        let mut segments = Segments::new(2);
        for reward in [1.0, 2.0, 3.0] {
            segments.push(segment(reward));
        }
        assert_eq!(segments.len(), 2);
        assert_eq!([segments.get(0), segments.get(1)].map(|s| s.rewards[0]), [3.0, 2.0]);
    }

    #[test]
    fn a_ring_from_a_file_fits_only_where_all_its_parts_do() {
        let decision = |bytes: usize, allocated: usize| Decision {
            state: vec![0; bytes],
            allocation: vec![0; allocated],
        };
        let segment = |now, next| Segment { now, rewards: vec![0.0; 2], discount: 0.9, next };
        let ring = |segment: Segment| Segments { capacity: 2, segments: vec![segment], next: 1 };
        let sound = ring(segment(decision(9, 2), decision(9, 2)));
        assert!(sound.fits(2) && !sound.fits(3) && !sound.is_empty());
        assert_eq!((sound.count(), Segments::new(2).is_empty()), (1, true));
        for broken in
            [segment(decision(9, 2), decision(8, 2)), segment(decision(9, 2), decision(9, 1))]
        {
            assert!(!ring(broken).fits(2));
        }
        let other = segment(decision(1, 1), decision(1, 1));
        let full = Segments { capacity: 2, segments: vec![other.clone(); 2], next: 0 };
        assert_eq!(full.count(), 2);
        assert!(full.fits(2) && !Segments { next: 2, ..full.clone() }.fits(2));
        assert!(!Segments { segments: vec![other; 3], ..full }.fits(2));
    }

    #[test]
    fn a_team_is_the_bits_of_its_agents() {
        let decision = Decision { allocation: vec![2, 0, 2, 255], ..Decision::default() };
        assert_eq!([0, 1, 2].map(|task| decision.team(task)), [0b10, 0, 0b101]);
    }

    fn network(seed: u64) -> UtilityNetwork {
        skipping(seed, false)
    }

    fn skipping(seed: u64, skip: bool) -> UtilityNetwork {
        let network = NetworkConfig { width: 16, base: 12, skip, ..NetworkConfig::default() };
        let shape = AllocatorConfig { network, ..AllocatorConfig::default() };
        let shape = shape.shape(toy().spec());
        UtilityNetwork::initialise(shape, 8.0, &mut generator(seed, Purpose::Weights, 0))
    }

    /// Segments between unrelated decisions; site 0 closes in every second one.
    fn segments() -> Segments {
        let mut segments = Segments::new(20);
        for number in 0..20_u8 {
            let mut street = Street::new(5, &[number % 7, 8, 15 - number % 5]);
            street.agents[0] += number % 9;
            let now = Decision::new(&street.bytes(), &[number % 3, 1, 2, 0, 1]);
            street.sites[0].1 = number % 2 == 1;
            let next = Decision::new(&street.bytes(), &[1; 5]);
            let rewards = (0..3).map(|task| task as f32 - 1.0).collect();
            let discount = if number % 5 == 0 { 0.0 } else { 0.95 };
            segments.push(Segment { now, rewards, discount, next });
        }
        segments
    }

    fn picks() -> Vec<Pick> {
        (0..20).map(|i| Pick { sample: i, symmetry: (i % 2) as u8, draw: i.into() }).collect()
    }

    #[test]
    fn the_gradient_of_the_loss_agrees_with_finite_differences() {
        for skip in [false, true] {
            check_gradient(&skipping(1, skip), &skipping(2, skip));
        }
    }

    fn check_gradient(online: &UtilityNetwork, target: &UtilityNetwork) {
        let segments = segments();
        let learn = |online: &UtilityNetwork| {
            let mut loss = TeamValueLoss::new(online.shape());
            let experience = Experience { environment: &toy(), replay: &segments };
            loss.learn(Networks { online, target }, experience, &picks());
            loss
        };
        let base = learn(online);
        for tensor in online.shape().tensors() {
            let at = &online.parameters()[tensor.range.clone()];
            assert_gradient(tensor.name, at, &base.gradient()[tensor.range.clone()], |moved| {
                let mut parameters = online.parameters().to_vec();
                parameters[tensor.range.clone()].copy_from_slice(moved);
                let online = UtilityNetwork::from_parameters(online.shape(), parameters);
                learn(&online.unwrap()).squared_error()
            });
        }
    }

    #[test]
    fn closed_subtasks_and_ended_episodes_do_not_bootstrap() {
        let (segments, target, environment) = (segments(), network(2), toy());
        let experience = Experience { environment: &environment, replay: &segments };
        let mut loss = TeamValueLoss::new(target.shape());
        for number in 0..20 {
            for task in 0..3 {
                let pick = Pick { sample: number as u32, symmetry: 0, draw: task as u64 };
                let picked = Picked::new(experience, &pick, &mut Observation::default());
                loss.find_targets(&target, &environment, &[picked.unwrap()]);
                let bootstraps = number % 5 != 0 && (task != 0 || number % 2 != 0);
                assert_eq!(loss.targets[0] != task as f32 - 1.0, bootstraps, "{number} {task}");
            }
        }
    }
}
