//! An environment whose agents fail: what a team learns in that is to go on without some of its members.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::observation::{ActionSet, AgentSet, EntitySet, Observation, TaskSet, members};
use crate::picture::Picture;
use crate::random::{Random, chance};
use crate::rows::SparseRows;
use crate::spec::Spec;

/// Bytes of the set of failed agents.
const SET_BYTES: usize = size_of::<AgentSet>();
/// The last action of an agent that has not acted yet.
const NO_ACTION: u8 = u8::MAX;

/// An environment in which agents fail for good at random moments, one of them at least never.
///
/// An agent that has failed stays where it is, [absent](Observation::absent) for the rest of its episode: it repeats its
/// last action while that is available, else it does the safe one, else the first, as the fallback of a deployed team.
/// States carry all that besides their own bytes. Where teams are measured nobody fails.
pub struct Failing {
    inner: Box<dyn Environment>,
    spec: Spec,
    /// How probable it is that an agent fails in a step.
    chance: f64,
    running: Vec<Running>,
    /// Room for the actions that are taken, a state, and what is seen in it.
    actions: Vec<u16>,
    state: Vec<u8>,
    seen: Observation,
}

/// What an instance remembers.
#[derive(Clone)]
struct Running {
    agents: usize,
    failed: AgentSet,
    /// `[A]`
    last_actions: Vec<u8>,
}

impl Failing {
    /// The same environment, in which an agent fails in a step with this chance.
    pub fn new(inner: Box<dyn Environment>, chance: f64) -> Self {
        let mut spec = inner.spec().clone();
        let agents = spec.shape.agents;
        spec.state_bytes += SET_BYTES + agents;
        let running = Running { agents: 0, failed: 0, last_actions: vec![NO_ACTION; agents] };
        let running = vec![running; inner.instances()];
        let (actions, state, seen) = Default::default();
        Self { inner, spec, chance, running, actions, state, seen }
    }

    /// The environment's own state, the failed agents, and the last actions.
    fn split<'s>(&self, state: &'s [u8]) -> (&'s [u8], AgentSet, &'s [u8]) {
        let (rest, last_actions) = state.split_at(state.len() - self.spec.shape.agents);
        let (own, failed) = rest.split_at(rest.len() - SET_BYTES);
        (own, AgentSet::from_le_bytes(failed.try_into().unwrap_or_default()), last_actions)
    }

    fn own<'s>(&self, state: &'s [u8]) -> &'s [u8] {
        self.split(state).0
    }

    /// What a failed agent does, of what it may do.
    fn fallback(&self, last_action: u8, available: ActionSet) -> u16 {
        let is_available = |action: &u16| *action < 64 && available >> *action & 1 == 1;
        let wishes = [Some(u16::from(last_action)), self.spec.safe_action];
        let wish = wishes.into_iter().flatten().find(is_available);
        wish.unwrap_or(available.trailing_zeros() as u16)
    }

    /// Looks at the masks of an instance.
    fn look(&mut self, instance: usize) {
        self.state.clear();
        self.inner.save(instance, &mut self.state);
        self.inner.observe(&self.state, 0, 0, &mut self.seen);
    }
}

impl Environment for Failing {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.inner.instances()
    }

    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment> {
        let chance = if split == Split::Train { self.chance } else { 0.0 };
        Box::new(Self::new(self.inner.open(instances, split), chance))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        self.inner.reset(instance, random);
        self.look(instance);
        let running = &mut self.running[instance];
        (running.agents, running.failed) = (self.seen.agents(), 0);
        running.last_actions.fill(NO_ACTION);
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        self.actions.clear();
        self.actions.extend_from_slice(actions);
        let failed = self.running[instance].failed;
        if failed != 0 {
            self.look(instance);
            for agent in members(failed.into()) {
                let last_action = self.running[instance].last_actions[agent];
                let action = self.fallback(last_action, self.seen.available[agent]);
                self.actions.get_mut(agent).into_iter().for_each(|taken| *taken = action);
            }
        }
        let mut step = self.inner.step(instance, &self.actions, random)?;
        let Running { agents, failed, last_actions } = &mut self.running[instance];
        last_actions.iter_mut().zip(&self.actions).for_each(|(last, action)| *last = *action as u8);
        // Where nobody may fail, nothing is drawn: episodes are those of the environment itself.
        let at_risk = if step.done() || self.chance == 0.0 { 0 } else { *agents };
        for agent in 0..at_risk {
            let is_last = failed.count_ones() as usize + 1 == *agents;
            if *failed >> agent & 1 == 0 && chance(random, self.chance) && !is_last {
                *failed |= 1 << agent;
                step.tasks_changed = true;
            }
        }
        Ok(step)
    }

    fn note_allocation(&mut self, instance: usize, allocation: &[u8]) {
        self.inner.note_allocation(instance, allocation);
    }

    fn task_rewards(&self, instance: usize) -> &[f64] {
        self.inner.task_rewards(instance)
    }

    fn agent_rewards(&self, instance: usize) -> &[f64] {
        self.inner.agent_rewards(instance)
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        self.inner.save(instance, state);
        let Running { failed, last_actions, .. } = &self.running[instance];
        state.extend_from_slice(&failed.to_le_bytes());
        state.extend_from_slice(last_actions);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let wanted = SET_BYTES + self.spec.shape.agents;
        if state.len() < wanted {
            return Err(StateError::Length { found: state.len(), wanted });
        }
        let (own, failed, last_actions) = self.split(state);
        if u128::from(failed) >> self.spec.shape.agents != 0 {
            let reason = "an agent that does not exist has failed";
            return Err(StateError::Impossible(reason.into()));
        }
        self.inner.load(instance, own)?;
        self.look(instance);
        let (agents, last_actions) = (self.seen.agents(), last_actions.to_vec());
        self.running[instance] = Running { agents, failed, last_actions };
        Ok(())
    }

    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation) {
        let (own, failed, last_actions) = self.split(state);
        // Environments in which nobody dies leave it as it is.
        seen.absent = 0;
        self.inner.observe(own, turn, wanted, seen);
        seen.absent |= failed;
        if failed == 0 {
            return;
        }
        let mut plain = Observation::default();
        self.inner.observe(own, 0, 0, &mut plain);
        for agent in members(failed.into()) {
            let action = self.fallback(last_actions[agent], plain.available[agent]);
            seen.available[agent] = 1 << self.inner.turned_action(turn, action);
        }
    }

    fn picture(&self, state: &[u8]) -> Picture {
        self.inner.picture(self.own(state))
    }

    fn place(&mut self, instance: usize, entity: usize, place: [f64; 2]) -> Result<(), StateError> {
        self.inner.place(instance, entity, place)
    }

    fn disturb(&mut self, instance: usize, thing: usize) -> Result<(), StateError> {
        self.inner.disturb(instance, thing)
    }

    fn episode(&self, instance: usize) -> Episode {
        self.inner.episode(instance)
    }

    fn turned_action(&self, turn: usize, action: u16) -> u16 {
        self.inner.turned_action(turn, action)
    }

    fn subtask_of(&self, state: &[u8], agent: usize, action: u16) -> Option<usize> {
        self.inner.subtask_of(self.own(state), agent, action)
    }

    /// The rule knows of no failures; what it gives failed agents is given to nobody.
    fn allocate(&self, rule: usize, state: &[u8], random: &mut Random, allocation: &mut [u8]) {
        let (own, failed, _) = self.split(state);
        self.inner.allocate(rule, own, random, allocation);
        for agent in members(failed.into()) {
            allocation[agent] = crate::UNASSIGNED;
        }
    }

    fn scripted(
        &self,
        state: &[u8],
        allocation: &[u8],
        random: &mut Random,
        actions: &mut [u16],
    ) -> bool {
        self.inner.scripted(self.own(state), allocation, random, actions)
    }

    fn potential(&self, state: &[u8], scale: f32, team: AgentSet, task: Option<usize>) -> f32 {
        self.inner.potential(self.own(state), scale, team, task)
    }

    fn potentials(&self, state: &[u8], scale: f32, potentials: &mut [f32]) {
        self.inner.potentials(self.own(state), scale, potentials);
    }

    fn offers(&self, state: &[u8], offers: &mut Vec<TaskSet>) -> TaskSet {
        let (own, failed, _) = self.split(state);
        let alone = self.inner.offers(own, offers);
        members(failed.into()).for_each(|agent| offers[agent] = 0);
        alone
    }

    fn relate(
        &self,
        state: &[u8],
        turn: usize,
        task: usize,
        wanted: EntitySet,
        rows: &mut SparseRows,
    ) {
        self.inner.relate(self.own(state), turn, task, wanted, rows);
    }

    fn milestone(&self, instance: usize) -> Option<usize> {
        self.inner.milestone(instance)
    }

    fn affordances(&self, state: &[u8]) -> Option<u32> {
        self.inner.affordances(self.own(state))
    }

    fn companions(&self, state: &[u8], companions: &mut [EntitySet]) -> bool {
        self.inner.companions(self.own(state), companions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{generator, member};
    use crate::{conformance, open};

    fn failing(name: &str, chance: f64) -> Failing {
        Failing::new(open(name, Split::Train, 1, &Default::default()).unwrap(), chance)
    }

    #[test]
    fn an_environment_in_which_nobody_fails_holds_to_the_laws() {
        for name in ["save-the-city", "group-matching", "particle/treasure-8", "gridworld"] {
            assert_eq!(conformance::check(&failing(name, 0.0), 3, 4), Ok(()), "{name}");
        }
    }

    #[test]
    fn agents_fail_for_the_rest_of_their_episode_and_never_all_of_them() {
        let (mut city, mut random) = (failing("save-the-city", 0.05), generator(1));
        let mut copy = failing("save-the-city", 0.05);
        let (mut state, mut again) = (Vec::new(), Vec::new());
        let (mut seen, mut before) = (Observation::default(), Observation::default());
        let mut failed = [0; 2];
        for _ in 0..40 {
            city.reset(0, &mut random);
            before.absent = 0;
            loop {
                state.clear();
                city.save(0, &mut state);
                copy.load(0, &state).unwrap();
                city.observe(&state, 0, EntitySet::MAX, &mut seen);
                assert_eq!(seen.absent & before.absent, before.absent);
                assert!(seen.acting() != 0 && seen.acting() & seen.absent == 0);
                assert_eq!(seen.entities, seen.present, "bodies stay");
                let mut allocation = [0; 5];
                city.allocate(0, &state, &mut random, &mut allocation);
                for agent in members(seen.absent.into()) {
                    assert_eq!(seen.available[agent].count_ones(), 1);
                    assert_eq!(allocation[agent], crate::UNASSIGNED);
                }
                let draw = |set: &ActionSet| member(&mut random, *set).unwrap_or(0) as u16;
                let actions: Vec<u16> = seen.available.iter().map(draw).collect();
                // What is asked of those who have failed makes no difference.
                let mut others = actions.clone();
                members(seen.absent.into()).for_each(|agent| others[agent] ^= 1);
                let mut same = random.clone();
                let step = city.step(0, &actions, &mut random).unwrap();
                assert_eq!(copy.step(0, &others, &mut same), Ok(step));
                again.clear();
                copy.save(0, &mut again);
                state.clear();
                city.save(0, &mut state);
                assert_eq!(state, again);
                let newly = city.running[0].failed & !seen.absent;
                assert!(newly == 0 || step.tasks_changed);
                failed[usize::from(newly != 0)] += 1;
                if step.done() {
                    break;
                }
                core::mem::swap(&mut seen, &mut before);
            }
        }
        assert!(failed[1] > 60, "{failed:?}");
    }

    #[test]
    fn a_failed_agent_repeats_its_last_action_while_it_can() {
        let city = failing("save-the-city", 0.0);
        let safe = city.spec().safe_action.unwrap();
        assert_eq!(city.fallback(3, 0b1111), 3);
        assert_eq!(city.fallback(3, 0b0111), safe);
        assert_eq!(city.fallback(NO_ACTION, 0b0111), safe);
        assert_eq!(city.fallback(NO_ACTION, 0b1100 & !(1 << safe)), 2);
    }

    #[test]
    fn where_teams_are_measured_nobody_fails_and_episodes_are_those_without_failures() {
        let city = failing("save-the-city", 1.0);
        let plays = |mut city: Box<dyn Environment>| {
            let (mut random, mut states) = (generator(1), Vec::new());
            let safe = [city.spec().safe_action.unwrap(); 5];
            for _ in 0..3 {
                city.reset(0, &mut random);
                while !city.step(0, &safe, &mut random).unwrap().done() {
                    states.push(Vec::new());
                    city.save(0, states.last_mut().unwrap());
                }
            }
            states
        };
        let plain = plays(city.inner.open(1, Split::Test));
        let measured = plays(city.open(1, Split::Test));
        assert_eq!(plain.len(), measured.len());
        for (plain, measured) in plain.iter().zip(&measured) {
            assert_eq!(city.split(measured).0, plain);
            assert_eq!(city.split(measured).1, 0);
        }
    }
}
