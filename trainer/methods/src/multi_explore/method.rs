//! The published learner as a [`Method`].

use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_learn::export::DeployedAgents;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::trajectory::{Capacity, Widths};
use sortie_learn::{
    Act, Ask, Head, LearnError, Method, Now, Scene, Scenes, State, Thought, Trajectories,
    Transition,
};
use sortie_nn::tape::Tape;

use super::Config;
use super::meta::{MetaPolicy, Moments};
use crate::actor_critic::acting::{Acting, Actors, Inputs, deployed, scores_of, show};
use crate::actor_critic::critic::Batch;
use crate::actor_critic::groups::best;
use crate::actor_critic::learner::ActorCritic;
use crate::novelty::{CELLS, Columns, Counts, Discounted, Intrinsic};

/// Agents of several heads, and what they have seen.
#[derive(Debug)]
pub struct MultiExplore {
    config: Config,
    columns: Columns,
    heads: Vec<Option<Intrinsic>>,
    learner: ActorCritic,
    replay: Trajectories,
    acting: Acting,
    meta: MetaPolicy,
    counts: Counts,
    /// By agents and heads: intrinsic rewards of what happened.
    moments: Vec<Moments>,
    /// By instances.
    episodes: Vec<Discounted>,
    /// Discounted returns of the episodes of this turn that ended.
    turn: Vec<f64>,
    /// `[steps, A]`: the cells that were stepped into since the last update.
    stepped: Vec<u16>,
    seen: Observation,
    /// Draws records, actions and heads.
    random: Random,
    /// Environment steps before the first update.
    first: u64,
    updates: u64,
    batch: Batch,
}

impl MultiExplore {
    /// Draws the first weights.
    ///
    /// # Panics
    /// The environment shows no places.
    pub fn new(config: Config, opening: &Opening<'_>) -> Self {
        let Opening { setup, environment, seed, threads } = *opening;
        let spec = environment.spec();
        let mut weights = generator(seed, Purpose::Weights, 0);
        let networks = Columns::of(spec).zip(config.learner(spec, threads, &mut weights));
        let (columns, learner) = networks.expect("the environment was found to fit");
        let (agents, instances) = (learner.groups.agents(), setup.environment.instances);
        let heads = config.heads();
        let capacity = Capacity::States(config.replay.capacity.div_ceil(instances));
        let mut random = generator(seed, Purpose::Replay, 0);
        Self {
            learner,
            replay: Trajectories::new(capacity, instances, Widths { agents, ..Widths::default() }),
            acting: Acting::default(),
            meta: MetaPolicy::new(heads.len(), &mut random),
            counts: Counts::new(agents, CELLS, heads.contains(&Some(Intrinsic::Centralized))),
            moments: vec![Moments::default(); agents * heads.len()],
            episodes: vec![Discounted::default(); instances],
            turn: Vec::new(),
            stepped: Vec::new(),
            seen: Observation::new(&spec.shape),
            // Every instance needs to have stepped.
            first: config.replay.batch.max(4 * instances) as u64,
            updates: 0,
            batch: Batch::default(),
            random,
            columns,
            heads,
            config,
        }
    }

    /// The policies of the head that is deployed.
    fn best(&self) -> Actors<'_> {
        actors(&self.learner, self.meta.best())
    }

    /// Looks where all agents are in a state and counts them there.
    fn visit(&mut self, environment: &dyn Environment, state: &[u8]) {
        environment.observe(state, 0, EntitySet::MAX, &mut self.seen);
        self.counts.visit(self.columns.cells(&self.seen.rows));
    }

    /// Adds by agents and heads what each is paid where they stand in these cells, not normalised yet.
    fn pay(&self, cells: impl Iterator<Item = u16> + Clone, paid: &mut [Vec<f32>]) {
        let team = self.counts.team_novelty(cells.clone());
        for (agent, cell) in cells.enumerate() {
            let novelties = self.counts.novelties(cell);
            for (head, kind) in self.heads.iter().enumerate() {
                let paid = &mut paid[agent * self.heads.len() + head];
                paid.extend(kind.map(|kind| kind.reward(novelties, team, agent)));
            }
        }
    }

    /// `[A]`: what agents think where this is seen, and what each head would pay and do there.
    fn thoughts(&self, seen: &Observation) -> Vec<Thought> {
        let Self { learner, heads, meta, .. } = self;
        let mut paid = vec![Vec::new(); self.moments.len()];
        self.pay(self.columns.cells(&seen.rows), &mut paid);
        let (mut tape, mut row) = (Tape::default(), vec![0.0; learner.groups.0[0].observed]);
        let thought = |agent: usize| {
            seen.rows.write_dense(agent, &mut row);
            let mut scores = |head| {
                let scores = scores_of(actors(learner, head), &mut tape, agent, &row);
                scores.unwrap_or_default()
            };
            let head = |(head, explores): (usize, &Option<Intrinsic>)| Head {
                name: explores.map_or("none", Intrinsic::name).to_owned(),
                pays: paid[agent * heads.len() + head].first().copied().unwrap_or_default(),
                likes: best(&scores(head)) as u16,
                acts: head == meta.best(),
            };
            let heads = heads.iter().enumerate().map(head).collect();
            Thought { scores: scores(meta.best()), heads, ..Thought::default() }
        };
        (0..learner.groups.agents()).map(thought).collect()
    }

    /// Adds what was paid for the last steps to the moments of intrinsic rewards.
    fn add_moments(&mut self) {
        let mut paid = vec![Vec::new(); self.moments.len()];
        for cells in self.stepped.chunks_exact(self.learner.groups.agents()) {
            self.pay(cells.iter().copied(), &mut paid);
        }
        for (moments, paid) in self.moments.iter_mut().zip(paid) {
            let paid: Vec<f64> = paid.into_iter().map(f64::from).collect();
            if !paid.is_empty() {
                moments.add(&paid);
            }
        }
        self.stepped.clear();
    }

    /// Draws records for an update. Intrinsic rewards are those of today, in today's deviations.
    fn gather(&mut self, environment: &dyn Environment) {
        let (mut batch, mut seen) =
            (std::mem::take(&mut self.batch), std::mem::take(&mut self.seen));
        let (groups, discount) = (&self.learner.groups, self.config.returns.discount);
        batch.clear(self.learner.sizes());
        for _ in 0..self.config.replay.batch {
            let place = self.replay.draw(1, &mut self.random);
            let future = self.replay.future(place, 1, discount);
            batch.add(groups, self.replay.actions(place), |_| future.reward, future.discount);
            let Batch { observations, next, states, .. } = &mut batch;
            for ((place, shown), state) in
                [(place, observations), (future.place, next)].into_iter().zip(states)
            {
                environment.observe(self.replay.state(place), 0, EntitySet::MAX, &mut seen);
                show(groups, 1.0, &seen, shown);
                self.columns.write_state(&seen.rows, state);
            }
            self.pay(self.columns.cells(&seen.rows), &mut batch.paid);
        }
        for (paid, moments) in batch.paid.iter_mut().zip(&self.moments) {
            let deviation = moments.variance.sqrt() as f32;
            paid.iter_mut().for_each(|reward| *reward /= deviation);
        }
        (self.batch, self.seen) = (batch, seen);
    }
}

/// One of the heads at work.
fn actors(learner: &ActorCritic, head: usize) -> Actors<'_> {
    let ActorCritic { groups, policies, policy_learner, .. } = learner;
    let inputs = Inputs { scale: 1.0, running: None };
    Actors { groups, inputs, policies, head, weights: &policy_learner.online.values }
}

impl Method for MultiExplore {
    /// All act by one head, an episode of every instance.
    fn waits(&self) -> bool {
        true
    }

    fn learns_while_waiting(&self) -> bool {
        true
    }

    fn begins(&mut self, instance: usize, _: &mut Random) {
        self.episodes[instance] = Discounted::default();
    }

    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>, _: Now) -> Result<(), LearnError> {
        for scene in scenes.scenes.iter().filter(|scene| scene.begins) {
            self.visit(scenes.environment, scene.state);
        }
        let actors = actors(&self.learner, self.meta.head);
        self.acting.act(actors, scenes, Some(random), actions);
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let Transition { environment, instance, step, next, .. } = *transition;
        self.visit(environment, next);
        self.stepped.extend(self.columns.cells(&self.seen.rows));
        self.replay.push(transition);
        let episode = &mut self.episodes[instance];
        episode.add(step.reward, self.config.returns.discount);
        if step.done() {
            self.turn.push(episode.sum);
        }
        if self.turn.len() == self.episodes.len() {
            self.meta.learn(&self.config.meta, &self.turn);
            self.meta.draw(self.config.meta.uniform, &mut self.random);
            self.turn.clear();
        }
        Ok(())
    }

    fn update(&mut self, environment: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        self.add_moments();
        let rule = &self.config.replay;
        let steps = now.env_steps.saturating_sub(self.first);
        let due = steps / rule.steps_per_period * rule.updates_per_period;
        let entropy = self.config.returns.entropy;
        let mut reports = Reports::default();
        while self.updates < due {
            self.updates += 1;
            self.gather(environment);
            let Self { learner, batch, random, .. } = self;
            reports.agents.push(learner.update(batch, entropy, random));
        }
        Ok(reports)
    }

    fn rates(&self, _: Now) -> Rates {
        Rates { epsilon: 0.0, learning_rate: self.config.optimiser.policy_rate }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(Greedy { team: self, actors: self.best(), acting: Acting::default() })
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        let actors = self.best();
        Ok(deployed(actors, actors.groups.0[0].actions))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.replay.visit(state)?;
        self.learner.state(state)?;
        state.kept("meta-policy", &mut self.meta)?;
        state.value("counts", &mut self.counts)?;
        state.value("moments", &mut self.moments)?;
        state.value("episodes", &mut self.episodes)?;
        state.value("turn", &mut self.turn)?;
        state.value("random", &mut self.random)?;
        state.value("updates", &mut self.updates)
    }
}

/// Agents that take the action that they think the likeliest, by one head.
struct Greedy<'a> {
    team: &'a MultiExplore,
    actors: Actors<'a>,
    acting: Acting,
}

impl Act for Greedy<'_> {
    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<(), LearnError> {
        self.acting.act(self.actors, scenes, None, actions);
        Ok(())
    }

    fn thoughts(&mut self, scenes: &Scenes<'_>, _: &[u16]) -> Vec<Thought> {
        let mut seen = Observation::default();
        let thoughts = |scene: &Scene<'_>| {
            scenes.environment.observe(scene.state, 0, EntitySet::MAX, &mut seen);
            self.team.thoughts(&seen)
        };
        scenes.scenes.iter().flat_map(thoughts).collect()
    }

    fn visits(&self) -> Vec<Vec<u32>> {
        self.team.counts.all()
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::{SparseRows, Split};

    use super::*;
    use crate::ma_exp::MA_EXP;

    /// Plays three instances in rounds, in small, for so many environment steps; returns how many those were.
    fn played(steps: u64) -> (MultiExplore, Reports, u64) {
        let small = [
            "environment.instances=3",
            "network.critic_width=8",
            "network.base_width=8",
            "network.head_width=4",
            "replay.batch=90",
            "replay.steps_per_period=30",
            "replay.updates_per_period=2",
        ];
        let set = |setup, assignment: &&str| MA_EXP.set(&setup, assignment).unwrap();
        let setup = small.iter().fold(MA_EXP.preset("paper").unwrap(), set);
        let world = sortie_envs::open("gridworld/task1-2", Split::Train, 1, &Default::default());
        let world = world.unwrap();
        let opening = Opening { setup: &setup, environment: &*world, seed: 1, threads: 1 };
        let mut method = MultiExplore::new(setup.own().unwrap(), &opening);
        let random = (0..3).map(|index| generator(1, Purpose::Rollout, index)).collect();
        let mut play = sortie_learn::play::Play::new(&*world, &mut method, random);
        let (mut reports, mut counts) = (Reports::default(), Default::default());
        let mut now = Now { env_steps: 0, of: 10_000 };
        while now.env_steps < steps {
            now.env_steps += play.round(&mut method, now, &mut counts).unwrap();
            reports.agents.extend(method.update(&*world, now).unwrap().agents);
        }
        (method, reports, now.env_steps)
    }

    #[test]
    fn as_many_updates_are_made_as_are_due_once_a_batch_is_there() {
        let (_, reports, steps) = played(240);
        assert_eq!((steps, reports.agents.len()), (240, 2 * 150 / 30));
        assert_eq!(played(87).1.agents.len(), 0);
    }

    #[test]
    fn cells_and_rewards_are_counted_once_a_step() {
        let (method, _, steps) = played(240);
        // The cells in which episodes began count too.
        let visits = |agent: usize| method.counts.all()[agent].iter().sum();
        let all: [u32; 2] = [0, 1].map(visits);
        assert_eq!(all, [steps as u32 + 3; 2]);
        let count = |moments: &Moments| (moments.count - 1e-4).round();
        assert!(method.moments.iter().all(|moments| count(moments) == steps as f64));
        assert_eq!(method.moments.len(), 10);
    }

    #[test]
    fn heads_are_paid_for_where_agents_came_to_by_todays_counts() {
        let (mut method, _, _) = played(120);
        method.gather(&*begun().0);
        let (batch, groups) = (&method.batch, &method.learner.groups);
        assert_eq!((batch.records, batch.paid.len(), groups.agents()), (90, 10, 2));
        let columns = &method.columns;
        for record in 0..90 {
            let seen = |of: &[Vec<f32>]| -> Vec<f32> {
                of.iter().flat_map(|own| &own[record * 15..][..15]).copied().collect()
            };
            let (before, after) = (seen(&batch.observations), seen(&batch.next));
            for (seen, states) in [(&before, &batch.states[0]), (&after, &batch.states[1])] {
                let (mut state, mut rows) = (Vec::new(), SparseRows::default());
                seen.chunks_exact(15).for_each(|row| rows.push_dense(row));
                columns.write_state(&rows, &mut state);
                assert_eq!((state.len(), &states[record * 102..][..102]), (102, &state[..]));
            }
            let mut rows = SparseRows::default();
            after.chunks_exact(15).for_each(|row| rows.push_dense(row));
            for (agent, cell) in columns.cells(&rows).enumerate() {
                let novelties = method.counts.novelties(cell);
                for (head, kind) in Intrinsic::CHOSEN.into_iter().enumerate() {
                    let place = agent * 5 + head;
                    let deviation = method.moments[place].variance.sqrt() as f32;
                    let want = kind.reward(novelties, 0.0, agent) / deviation;
                    assert_eq!(batch.paid[place][record], want);
                }
            }
            // The team's reward as it is: a step costs 0.2.
            let rewards = [0, 1].map(|agent| batch.rewards[agent][record]);
            assert!(rewards == [-0.2; 2] && batch.discounts[0][record] == 0.99);
        }
    }

    /// The gridworld, and a state in which an episode begins.
    fn begun() -> (Box<dyn Environment>, Vec<u8>) {
        let world = sortie_envs::open("gridworld/task1-2", Split::Train, 1, &Default::default());
        let mut world = world.unwrap();
        world.reset(0, &mut generator(1, Purpose::Rollout, 7));
        let mut state = Vec::new();
        world.save(0, &mut state);
        (world, state)
    }

    #[test]
    fn agents_do_what_they_think_best_and_tell_what_heads_would_pay() {
        let (method, _, _) = played(120);
        let (world, state) = begun();
        let scene = Scene { instance: 0, state: &state, begins: true, tasks_changed: false };
        let scenes = Scenes { environment: &*world, scenes: &[scene] };
        let (mut team, mut actions) = (method.team(), [0; 2]);
        let random = &mut [generator(1, Purpose::Rollout, 8)];
        team.act(Ask { scenes: &scenes, random, actions: &mut actions }).unwrap();
        let thoughts = team.thoughts(&scenes, &actions);
        assert_eq!(thoughts.len(), 2);
        assert_eq!(team.visits()[1].iter().sum::<u32>(), 120 + 3);
        let mut seen = Observation::default();
        world.observe(&state, 0, EntitySet::MAX, &mut seen);
        let cells: Vec<u16> = method.columns.cells(&seen.rows).collect();
        for (agent, thought) in thoughts.iter().enumerate() {
            assert_eq!(best(&thought.scores), u32::from(actions[agent]));
            assert_eq!(thought.heads.len(), 5);
            let novelties = method.counts.novelties(cells[agent]);
            for (head, kind) in thought.heads.iter().zip(Intrinsic::CHOSEN) {
                assert_eq!(
                    (&*head.name, head.pays),
                    (kind.name(), kind.reward(novelties, 0.0, agent))
                );
            }
            let acts: Vec<u16> =
                thought.heads.iter().filter(|head| head.acts).map(|head| head.likes).collect();
            assert_eq!(acts, [actions[agent]]);
        }
    }

    #[test]
    fn a_turn_is_an_episode_of_every_instance_under_one_head() {
        let (mut method, _, _) = played(3);
        let first = method.meta.clone();
        let (world, state) = begun();
        let end = |method: &mut MultiExplore, instance: usize, reward: f64| {
            let step = sortie_envs::Step { reward, timed_out: true, ..Default::default() };
            let transition = Transition {
                environment: &*world,
                instance,
                state: &state,
                actions: &[0, 0],
                step,
                task_rewards: &[],
                agent_rewards: &[],
                next: &state,
            };
            method.remember(&transition).unwrap();
        };
        for (instance, reward) in [(0, 5.0), (1, 7.0)] {
            method.episodes[instance] = Discounted { sum: 1.0, factor: 0.5 };
            end(&mut method, instance, reward);
        }
        assert_eq!((&method.meta, &method.turn[..]), (&first, &[3.5, 4.5][..]));
        method.episodes[2] = Discounted { sum: 1.0, factor: 0.5 };
        end(&mut method, 2, 8.0);
        assert!(method.turn.is_empty());
        assert!((method.meta.returns[first.head].mean - 13.0 / 3.0).abs() < 1e-3);
        assert!(method.meta.scores != first.scores);
    }
}
