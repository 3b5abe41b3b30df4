//! Random observations, team queries and entities of all mask patterns, by seed.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_bundle::{OwnedAllocationState, OwnedObservation};
use sortie_core::allocate::TeamQuery;
use sortie_core::{AllocationState, Entities, EntityMask, NO_ACTION, limits};

use crate::policy::{InputRole, PolicyFacts, PolicyInput, ValueType};

/// A team at a subtask, with all that its value depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedTeamQuery {
    /// Entities, subtasks and agents.
    pub state: OwnedAllocationState,
    /// The subtask.
    pub task: usize,
    /// Bit a set where agent a is in the team.
    pub team: u64,
    /// How each entity relates to the subtask, `[N, F]`.
    pub relation: Vec<f32>,
}

impl OwnedTeamQuery {
    /// The query as networks take it. `state` is the view of this query's state.
    pub fn view<'a>(&'a self, state: &'a AllocationState<'a>) -> TeamQuery<'a> {
        TeamQuery { state, task: self.task, team: self.team, relation: &self.relation }
    }
}

/// All entities of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedEntities {
    /// Features `[N, d]`.
    pub rows: Vec<f32>,
    /// Features d.
    pub features: usize,
    /// The entities that exist.
    pub present: EntityMask,
    /// The agents, present or not.
    pub agents: EntityMask,
    /// The groups `[N]` of every entity: bit t for group t.
    pub groups: Vec<u32>,
}

impl OwnedEntities {
    /// The entities as networks take them.
    pub fn view(&self) -> Entities<'_> {
        let Self { rows, features: stride, present, agents, groups } = self;
        Entities { rows, stride: *stride, present: *present, agents: *agents, groups }
    }
}

/// `count` times random numbers for every input of a policy that is no state: features, around the means that the policy
/// normalises by where it does; small whole numbers; and masks whose rows hold both, as nobody knows which of both hides
/// everything.
pub fn random_policy_inputs(count: usize, facts: &PolicyFacts, seed: u64) -> Vec<Vec<Vec<f32>>> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    let mut input = |input: &PolicyInput, sparse: bool| {
        let is_mask = match input.role {
            InputRole::Observation => input.kind == ValueType::Bool,
            InputRole::Available | InputRole::Mask { .. } => true,
            // Other floats beside observations are masks.
            InputRole::Extra => input.kind.is_mask() || input.kind.is_float(),
            _ => input.kind.is_mask(),
        };
        let mut number = |place: usize| match input.kind {
            _ if is_mask => f32::from(u8::from(random.below(3) > 0)),
            kind if kind.is_integer() => random.below(2) as f32,
            ValueType::U8 => random.below(256) as f32,
            _ => match input.normals.get(place) {
                // As wide as a normal's numbers are, nearly all of them.
                Some([mean, deviation]) => {
                    let number = mean + 2.0 * deviation * random.feature(sparse);
                    number.clamp(f32::MIN, f32::MAX)
                }
                None => random.feature(sparse),
            },
        };
        let mut numbers: Vec<f32> = (0..input.length()).map(&mut number).collect();
        let row = input.shape.last().map_or(1, |size| *size).max(1);
        for row in numbers.chunks_mut(row).filter(|row| is_mask && row.len() > 1) {
            let is_same = row.iter().all(|number| row.first() == Some(number));
            row.iter_mut().take(usize::from(is_same)).for_each(|number| *number = 1.0 - *number);
        }
        numbers
    };
    let case = |index| facts.given().map(|given| input(given, index % 2 == 1)).collect();
    (0..count).map(case).collect()
}

/// The same, every eighth time with features eight times as far from their means: networks cut off what is far from them, and
/// where they do so nothing near the means shows.
pub fn policy_inputs_near_and_far(
    count: usize,
    facts: &PolicyFacts,
    seed: u64,
) -> Vec<Vec<Vec<f32>>> {
    let mut all = random_policy_inputs(count, facts, seed);
    for given in all.iter_mut().skip(6).step_by(8) {
        for (input, numbers) in facts.given().zip(given) {
            let is_seen = matches!(input.role, InputRole::Observation | InputRole::Entities { .. });
            if !is_seen || !input.kind.is_float() {
                continue;
            }
            for (place, number) in numbers.iter_mut().enumerate() {
                let mean = input.normals.get(place).map_or(0.0, |[mean, _]| *mean);
                *number = (mean + 8.0 * (*number - mean)).clamp(f32::MIN, f32::MAX);
            }
        }
    }
    all
}

/// `count` random steps of up to `n_max` entities and `groups` groups: everything, nothing, one, all but one or any
/// of them present, the same of agents.
pub fn random_entities(
    count: usize,
    n_max: usize,
    features: usize,
    groups: usize,
    seed: u64,
) -> Vec<OwnedEntities> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    let mut entities = |index| {
        let entities = 1 + random.below(n_max.max(1));
        random.entities(index, entities, [features, groups])
    };
    (0..count).map(&mut entities).collect()
}

/// `count` random states of up to `n_max` entities and `tasks` subtasks: agents with and without a last subtask, others
/// that belong to one, to none or to several, any of them absent, any subtask closed.
pub fn random_allocation_states(
    count: usize,
    n_max: usize,
    features: usize,
    tasks: usize,
    seed: u64,
) -> Vec<OwnedAllocationState> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    (0..count).map(|index| random.allocation_state(index, n_max, features, tasks)).collect()
}

/// `count` random observations of up to `n_max` entities: rows sparse and dense in turn, masks that show
/// everything, nothing, only the agent itself, everything but itself, or any entities.
pub fn random_observations(
    count: usize,
    n_max: usize,
    features: usize,
    actions: usize,
    seed: u64,
) -> Vec<OwnedObservation> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    let mut observation = |index| {
        let entities = 1 + random.below(n_max.max(1));
        random.observation(index, entities, features, actions)
    };
    (0..count).map(&mut observation).collect()
}

/// The same with exactly `entities` entities each.
pub fn random_observations_of(
    count: usize,
    entities: usize,
    features: usize,
    actions: usize,
    seed: u64,
) -> Vec<OwnedObservation> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    (0..count).map(|index| random.observation(index, entities.max(1), features, actions)).collect()
}

/// `count` random team queries of up to `n_max` entities, teams and masks of all patterns: everybody,
/// nobody, anybody; the subtask's own row may be absent.
pub fn random_team_queries(
    count: usize,
    n_max: usize,
    features: usize,
    relations: usize,
    seed: u64,
) -> Vec<OwnedTeamQuery> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    let mut query = |index| {
        let tasks = 1 + random.below(n_max.clamp(1, limits::TASKS));
        let agents = random.below(most_agents(n_max.max(1), tasks) + 1);
        random.team_query(index, agents, tasks, [features, relations])
    };
    (0..count).map(&mut query).collect()
}

/// The same with exactly `entities` entities each, as far as there can be so many agents and subtasks.
pub fn random_team_queries_of(
    count: usize,
    entities: usize,
    features: usize,
    relations: usize,
    seed: u64,
) -> Vec<OwnedTeamQuery> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    let tasks = entities.div_ceil(2).clamp(1, limits::TASKS);
    let agents = most_agents(entities, tasks);
    (0..count).map(|index| random.team_query(index, agents, tasks, [features, relations])).collect()
}

/// As many agents as a state of `entities` can have: each needs two rows where several teams are valued together.
fn most_agents(entities: usize, tasks: usize) -> usize {
    let rows = limits::ENTITIES.saturating_sub(tasks);
    entities.saturating_sub(tasks).min(limits::AGENTS).min(rows / 2)
}

/// Random recurrent states of `size` numbers in [-1, 1], the first one zeros as at an episode's start.
pub fn random_states(size: usize, seed: u64) -> impl FnMut() -> Vec<f32> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    let mut bound = 0.0;
    move || {
        let state = (0..size).map(|_| random.feature(false) * bound).collect();
        bound = 1.0;
        state
    }
}

struct Random(Xoshiro256PlusPlus);

impl Random {
    fn observation(
        &mut self,
        index: usize,
        entities: usize,
        features: usize,
        actions: usize,
    ) -> OwnedObservation {
        let agents = 1 + self.below(entities);
        let self_index = self.below(agents);
        let sparse = index.is_multiple_of(2);
        let rows = (0..entities * features).map(|_| self.feature(sparse)).collect();
        let last_actions = (0..agents).map(|_| self.last_action(actions)).collect();
        let mut available: Vec<u16> = (0..actions).map(|_| self.below(2) as u16).collect();
        let any = self.below(actions);
        available.iter_mut().skip(any).take(1).for_each(|code| *code = 1);
        let visible = self.visible(index / 2 % 5, entities, self_index);
        OwnedObservation { rows, features, last_actions, visible, self_index, available }
    }

    fn team_query(
        &mut self,
        index: usize,
        agents: usize,
        tasks: usize,
        [features, relations]: [usize; 2],
    ) -> OwnedTeamQuery {
        let (entities, task) = (agents + tasks, self.below(tasks));
        let own = agents + task;
        let sparse = index.is_multiple_of(2);
        let rows = (0..entities * features).map(|_| self.feature(sparse)).collect();
        let relation = (0..entities * relations).map(|_| self.feature(sparse)).collect();
        let present = self.visible(index / 2 % 5, entities, own);
        let open = self.visible(index / 10 % 5, tasks, task);
        let members = self.visible(index / 3 % 2 * 4, agents, 0);
        let bits = |mask: EntityMask| mask.words().first().copied().unwrap_or(0);
        let entity_task = (0..agents).map(|_| 0).chain((0..tasks).map(|task| 1 << task)).collect();
        let open_tasks = bits(open) as u32 | 1 << task;
        let state = OwnedAllocationState {
            agents,
            tasks,
            rows,
            features,
            present,
            entity_task,
            open_tasks,
            available: Vec::new(),
        };
        OwnedTeamQuery { state, task, team: bits(members), relation }
    }

    fn allocation_state(
        &mut self,
        index: usize,
        n_max: usize,
        features: usize,
        tasks: usize,
    ) -> OwnedAllocationState {
        let entities = 1 + self.below(n_max);
        let agents = self.below(entities + 1).min(limits::AGENTS);
        let tasks = 1 + self.below(tasks);
        let sparse = index.is_multiple_of(2);
        let most = u32::MAX >> (32 - tasks.min(32));
        let mut tasks_of = |_| match self.below(8) {
            0 => 0,
            1 => self.0.next_u32() & most,
            _ => 1 << self.below(tasks),
        };
        let entity_task = (0..entities).map(&mut tasks_of).collect();
        let open = self.visible(index / 5 % 5, tasks, 0).words().first().copied().unwrap_or(0);
        OwnedAllocationState {
            agents,
            tasks,
            rows: (0..entities * features).map(|_| self.feature(sparse)).collect(),
            features,
            present: self.visible([0, 4, 4, 4, 3][index % 5], entities, 0),
            entity_task,
            open_tasks: open as u32,
            available: Vec::new(),
        }
    }

    fn entities(
        &mut self,
        index: usize,
        entities: usize,
        [features, groups]: [usize; 2],
    ) -> OwnedEntities {
        let sparse = index.is_multiple_of(2);
        let one = self.below(entities);
        let most = u32::MAX.checked_shr(32 - groups.min(32) as u32).unwrap_or(0);
        OwnedEntities {
            rows: (0..entities * features).map(|_| self.feature(sparse)).collect(),
            features,
            present: self.visible(index / 2 % 5, entities, one),
            agents: self.visible(index / 10 % 5, entities, one),
            groups: (0..entities).map(|_| self.0.next_u32() & most).collect(),
        }
    }

    fn visible(&mut self, pattern: usize, entities: usize, own: usize) -> EntityMask {
        let mut mask = EntityMask::EMPTY;
        for entity in 0..entities {
            let shown = match pattern {
                0 => true,
                1 => false,
                2 => entity == own,
                3 => entity != own,
                _ => self.below(2) == 0,
            };
            if shown {
                mask.insert(entity);
            }
        }
        mask
    }

    fn feature(&mut self, sparse: bool) -> f32 {
        let zero = sparse && self.below(6) > 0;
        let value = (self.0.next_u32() >> 8) as f32 / (1 << 23) as f32 - 1.0;
        if zero { 0.0 } else { value }
    }

    fn last_action(&mut self, actions: usize) -> u16 {
        match self.below(actions + 1) {
            none if none == actions => NO_ACTION,
            action => action as u16,
        }
    }

    /// A number below `bound`; the bias of the modulo does not matter here.
    fn below(&mut self, bound: usize) -> usize {
        (self.0.next_u32() as usize).checked_rem(bound).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_observations() {
        assert_eq!(random_observations(20, 9, 5, 3, 1), random_observations(20, 9, 5, 3, 1));
        assert_ne!(random_observations(20, 9, 5, 3, 1), random_observations(20, 9, 5, 3, 2));
    }

    #[test]
    fn numbers_that_are_normalised_are_drawn_around_their_means() {
        let input = |role, normals| PolicyInput {
            name: "obs".to_owned(),
            kind: ValueType::F32,
            shape: vec![1, 2],
            role,
            normals,
        };
        let facts = PolicyFacts {
            inputs: vec![
                input(InputRole::Observation, vec![[50.0, 0.5], [-3.0, 2.0]]),
                input(InputRole::Extra, Vec::new()),
            ],
            outputs: Vec::new(),
            states: Vec::new(),
            operators: Default::default(),
            parameters: 0,
            multiply_adds: None,
        };
        let all = random_policy_inputs(100, &facts, 3);
        let numbers = |place: usize| all.iter().map(move |given| given[0][place]);
        assert!(numbers(0).all(|x| (49.0..=51.0).contains(&x)) && numbers(0).any(|x| x < 49.5));
        assert!(numbers(1).all(|x| (-7.0..=1.0).contains(&x)) && numbers(1).any(|x| x > 0.0));
        assert!(all.iter().all(|given| given[1].iter().sum::<f32>() == 1.0), "a mask holds both");
        let far = policy_inputs_near_and_far(100, &facts, 3);
        let from_mean = |given: &[Vec<f32>]| given[0][0] - 50.0;
        for (index, (far, near)) in far.iter().zip(&all).enumerate() {
            let times = if index % 8 == 6 { 8.0 } else { 1.0 };
            assert!((from_mean(far) - times * from_mean(near)).abs() < 1.0e-4 && far[1] == near[1]);
        }
    }

    #[test]
    fn every_mask_pattern_and_an_available_action_occur() {
        let all = random_observations(100, 6, 4, 3, 7);
        let own = |o: &OwnedObservation| o.visible.contains(o.self_index);
        assert!(all.iter().any(|o| o.visible.is_empty()));
        assert!(all.iter().any(|o| o.visible.len() == o.entities() && o.entities() == 6));
        assert!(all.iter().any(|o| o.visible.len() == 1 && own(o)));
        assert!(all.iter().any(|o| !own(o) && !o.visible.is_empty()));
        assert!(all.iter().all(|o| o.available.iter().any(|&code| code > 0)));
    }

    #[test]
    fn entities_of_every_kind_occur() {
        let all = random_entities(100, 6, 4, 3, 7);
        assert_eq!(all, random_entities(100, 6, 4, 3, 7));
        let absent_agent = |step: &OwnedEntities| step.agents.and(&step.present) != step.agents;
        assert!(all.iter().any(|step| step.present.is_empty() && !step.agents.is_empty()));
        assert!(all.iter().any(|step| step.present.len() == step.groups.len()));
        assert!(all.iter().any(|step| step.agents.is_empty() && step.present.len() > 2));
        assert!(all.iter().any(|step| absent_agent(step) && !step.present.is_empty()));
        assert!(all.iter().flat_map(|step| &step.groups).all(|groups| *groups < 8));
    }

    #[test]
    fn every_kind_of_team_and_absence_occurs() {
        let all = random_team_queries(300, 9, 4, 2, 7);
        assert_eq!(all, random_team_queries(300, 9, 4, 2, 7));
        let own = |query: &OwnedTeamQuery| query.state.agents + query.task;
        let absent = |query: &&OwnedTeamQuery| !query.state.present.contains(own(query));
        assert!(all.iter().any(|query| absent(&query)));
        assert!(all.iter().any(|query| query.team == 0 && query.state.agents > 2));
        assert!(all.iter().any(|query| query.team.count_ones() as usize == query.state.agents));
        assert!(all.iter().all(|query| query.state.entities() <= 9));
        assert!(all.iter().all(|query| query.state.open().any(|task| task == query.task)));
    }
}
