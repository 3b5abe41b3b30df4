//! Deciding in the environment by proposal policy and critic.

use rand_core::Rng;
use sortie_envs::random::{chance, member};
use sortie_envs::{EntitySet, Observation, Spec};
use sortie_learn::LearnError;
use sortie_learn::subtasks::{Allocate, PROPOSALS, ToAllocate};

use super::allocation::{AllocationNetworks, Decider, Noise, States, TaskColumns};
use super::config::Exploration;

/// Proposes allocations and takes the one that the critic values most; while learning other decisions are tried out.
#[derive(Debug)]
pub struct ProposalAllocator<'a> {
    networks: AllocationNetworks<'a>,
    proposals: usize,
    /// Whether the first proposal is what the policy holds most probable, as deployed allocators have it.
    pub(super) greedy_first: bool,
    /// What is tried out, if anything; task columns are shuffled then.
    pub(super) exploration: Option<Exploration>,
    decider: Decider,
    seen: Observation,
}

impl<'a> ProposalAllocator<'a> {
    /// An allocator that chooses among so many proposals.
    pub fn new(networks: AllocationNetworks<'a>, proposals: usize) -> Self {
        Self {
            networks,
            proposals,
            greedy_first: false,
            exploration: None,
            decider: Decider::default(),
            seen: Observation::default(),
        }
    }
}

impl Allocate for ProposalAllocator<'_> {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<(), LearnError> {
        let ToAllocate { environment, state, random, allocation } = to;
        let Self { networks, proposals, greedy_first, exploration, decider, seen } = self;
        environment.observe(state, 0, EntitySet::MAX, seen);
        let (agents, tasks) = (allocation.len(), seen.tasks());
        let known = networks.policy.shape.columns;
        if tasks > known {
            let reason = format!("the allocator knows {known} subtasks, this state has {tasks}");
            return Err(LearnError::Config(reason));
        }
        let mut states = States::new(agents, seen.entity_task.len(), tasks);
        states.push_seen(seen, allocation);
        let columns = match exploration {
            Some(_) => TaskColumns::shuffled(tasks, known, random),
            None => TaskColumns::in_order(tasks),
        };
        let noise = Noise::Seeded { seed: random.next_u64(), greedy_first: *greedy_first };
        let decided = decider.decide(*networks, &states, &columns, (*proposals, noise));
        allocation.copy_from_slice(&decided.best);
        let Some(Exploration { proposal, allocation: anywhere, .. }) = *exploration else {
            return Ok(());
        };
        if chance(random, proposal.into()) {
            allocation.copy_from_slice(&decided.first);
        }
        for task in &mut allocation[..seen.agents()] {
            if seen.open_tasks != 0
                && chance(random, anywhere.into())
                && let Some(drawn) = member(random, seen.open_tasks)
            {
                *task = drawn as u8;
            }
        }
        Ok(())
    }

    fn choose_among(&mut self, proposals: Option<usize>, _: &Spec) -> bool {
        self.proposals = proposals.unwrap_or(PROPOSALS);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::windows::NO_TASK;
    use crate::alma::windows::allocation::{AllocationCritic, AllocationPolicy, AllocationShape};
    use crate::alma::windows::{Note, Replay, SampleShape, Windows, cut_windows};
    use sortie_envs::{Environment, Split, Step};
    use sortie_learn::Transition;
    use sortie_learn::random::{Purpose, generator};
    use sortie_nn::random::Generator;

    fn draws(index: u64) -> Generator {
        generator(3, Purpose::Proposals, index)
    }

    fn city() -> Box<dyn Environment> {
        sortie_envs::open("save-the-city/2-5a_2-5b", Split::Train, 1, &Default::default()).unwrap()
    }

    /// The first state of an episode, and a window of it.
    fn start(number: u64) -> (Vec<u8>, Windows) {
        let mut city = city();
        city.reset(0, &mut draws(number));
        let mut state = Vec::new();
        city.save(0, &mut state);
        let shape = city.spec().shape;
        let mut replay = Replay::new(1, 1, &shape);
        let step = Step { terminated: true, ..Step::default() };
        let transition = Transition {
            environment: &*city,
            instance: 0,
            state: &state,
            actions: &vec![0; shape.agents],
            step,
            task_rewards: &[],
            agent_rewards: &[],
            next: &state,
        };
        let note = Note { decision: true, added: 0 };
        replay.push(&transition, &vec![NO_TASK; shape.agents], note);
        let sample = SampleShape { windows: 1, steps: 1, ..SampleShape::default() };
        (state, cut_windows(&*city, &replay, &replay.episodes(), sample, &mut draws(0)))
    }

    fn networks() -> (AllocationPolicy, AllocationCritic) {
        let shape = city().spec().shape;
        let (features, columns) = (shape.features, shape.tasks);
        let shape = AllocationShape { features, columns, width: 16, heads: 4 };
        let policy = AllocationPolicy::initialise(shape, &mut draws(1));
        (policy, AllocationCritic::initialise(shape, &mut draws(2)))
    }

    fn decide(
        allocator: &mut ProposalAllocator<'_>,
        state: &[u8],
        random: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        allocator.allocate(ToAllocate { environment: &*city(), state, random, allocation })
    }

    #[test]
    fn what_is_decided_in_a_state_is_what_a_window_of_it_gives() {
        let (policy, critic) = networks();
        let networks = AllocationNetworks { policy: &policy, critic: &critic };
        let mut allocator = ProposalAllocator::new(networks, 8);
        let mut decided = Vec::new();
        for number in 0..20 {
            let (state, windows) = start(number);
            let sizes = windows.shape;
            let last: Vec<u8> = (0..sizes.agents).map(|agent| (agent % 2) as u8).collect();
            let mut states = States::new(sizes.agents, sizes.entities, sizes.tasks);
            states.push(&windows, 0, &last);
            let noise = Noise::Seeded { seed: draws(number).next_u64(), greedy_first: false };
            let columns = TaskColumns::in_order(sizes.tasks);
            let want = Decider::default().decide(networks, &states, &columns, (8, noise));

            let mut allocation = last.clone();
            decide(&mut allocator, &state, &mut draws(number), &mut allocation).unwrap();
            assert_eq!(allocation, want.best);
            decided.push(allocation);
        }
        decided.sort();
        decided.dedup();
        assert!(decided.len() > 10, "{decided:?}");
    }

    #[test]
    fn agents_that_exist_try_out_open_subtasks() {
        let (policy, critic) = networks();
        let networks = AllocationNetworks { policy: &policy, critic: &critic };
        let exploration = Exploration { allocation: 1.0, ..Exploration::default() };
        let mut allocator = ProposalAllocator::new(networks, 8);
        allocator.exploration = Some(exploration);
        // A start with fewer agents and subtasks than there may be.
        let few = |windows: &Windows| {
            windows.open.contains(&false) && !windows.present[windows.shape.agents - 1]
        };
        let mut starts = (0..).map(start);
        let (state, windows) = starts.find(|(_, windows)| few(windows)).unwrap();
        let sizes = windows.shape;
        let mut met = vec![false; sizes.tasks];
        for number in 0..50 {
            let (mut random, mut allocation) = (draws(number), vec![NO_TASK; sizes.agents]);
            decide(&mut allocator, &state, &mut random, &mut allocation).unwrap();
            for (task, present) in allocation.into_iter().zip(&windows.present) {
                assert_eq!(task != NO_TASK, *present);
                if *present {
                    met[usize::from(task)] = true;
                }
            }
        }
        assert_eq!(met, windows.open);
    }

    #[test]
    fn more_subtasks_than_the_networks_know_are_refused() {
        let shape = AllocationShape { features: 58, columns: 1, width: 16, heads: 4 };
        let policy = AllocationPolicy::initialise(shape, &mut draws(1));
        let critic = AllocationCritic::initialise(shape, &mut draws(2));
        let networks = AllocationNetworks { policy: &policy, critic: &critic };
        let mut allocator = ProposalAllocator::new(networks, 8);
        let error = decide(&mut allocator, &start(0).0, &mut draws(0), &mut [NO_TASK; 5]);
        let error = error.unwrap_err().to_string();
        assert!(error.contains("knows 1 subtasks, this state has"), "{error}");
    }
}
