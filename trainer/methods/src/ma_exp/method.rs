//! MA-Exp as a [`Method`].

use serde::{Deserialize, Serialize};
use sortie_envs::random::{below, chance, unit};
use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_learn::export::DeployedAgents;
use sortie_learn::random::by_weight;
use sortie_learn::run::{Rates, Reports};
use sortie_learn::session::Opening;
use sortie_learn::{
    Act, Ask, Head, LearnError, Method, Now, Scene, Scenes, State, Thought, Transition,
};

use super::Config;
use super::learner::{Deed, Learner, Rules, deployed};
use super::table::{ACTIONS, Row, Version};
use crate::novelty::{Columns, Discounted, Intrinsic, Place, shares};

/// Noise by which equal actions are told apart.
const TIES: f32 = 1e-3;

/// Agents that explore together.
#[derive(Debug)]
pub struct MaExp {
    config: Config,
    rules: Rules,
    columns: Columns,
    learner: Learner,
    selector: Selector,
    running: Vec<Running>,
    /// Whether only the last head acts.
    exploits: bool,
    /// Environment steps of the next sweep.
    next_sweep: u64,
    seen: Observation,
}

/// The running episode of an instance.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Running {
    head: usize,
    /// `[agents]`: where they are.
    places: Vec<Place>,
    /// `[agents]`: the rows of that.
    rows: Vec<u32>,
    /// `[steps, agents]`: rows that were acted in since the last were backed up.
    trail: Vec<u32>,
    discounted: Discounted,
    episode_return: f64,
    /// Number of the frozen policy that is tried out; 0 where none is.
    audition: u32,
}

impl MaExp {
    /// A team that has been nowhere.
    ///
    /// # Panics
    /// The environment shows no places.
    pub fn new(config: Config, opening: &Opening<'_>) -> Self {
        let spec = opening.environment.spec();
        let columns = Columns::of(spec).expect("the environment was found to fit");
        let rules = config.rules();
        let starts = [config.values.start, config.values.intrinsic_start];
        Self {
            learner: Learner::new(&rules, spec.shape.agents, columns.treasures(), starts),
            selector: Selector::new(rules.heads.len()),
            running: vec![Running::default(); opening.setup.environment.instances],
            exploits: false,
            next_sweep: config.values.sweep_every,
            seen: Observation::new(&spec.shape),
            columns,
            rules,
            config,
        }
    }

    fn epsilon(&self) -> f32 {
        let exploration = &self.config.exploration;
        if self.exploits { exploration.last_epsilon } else { exploration.epsilon }
    }
}

/// Writes `[agents]` where they are in a state.
fn look(
    environment: &dyn Environment,
    columns: &Columns,
    state: &[u8],
    seen: &mut Observation,
    places: &mut Vec<Place>,
) {
    environment.observe(state, 0, EntitySet::MAX, seen);
    places.clear();
    places.extend((0..seen.rows.len()).map(|agent| columns.place(&seen.rows, agent)));
}

/// The action that a head likes best in a place, any of equal ones.
fn liked(row: &Row, head: usize, rules: &Rules, random: &mut Random) -> u16 {
    let score = |action: usize| row.score(action, head, &rules.weights);
    let mut best = (f32::NEG_INFINITY, 0);
    for action in 0..ACTIONS {
        let score = score(action) + TIES * unit(random) as f32;
        if score > best.0 {
            best = (score, action as u16);
        }
    }
    best.1
}

impl Method for MaExp {
    fn begins(&mut self, instance: usize, random: &mut Random) {
        let heads = &self.config.heads;
        let running = &mut self.running[instance];
        running.head = if self.exploits {
            self.rules.heads.len() - 1
        } else {
            self.selector.choose(heads.any, heads.temperature, random)
        };
        (running.discounted, running.episode_return) = (Discounted::default(), 0.0);
        running.audition = 0;
        let audition = &self.config.audition;
        if self.exploits && instance < audition.instances {
            if self.learner.audition.is_over(audition.episodes) {
                self.learner.audition_next();
            }
            running.audition = self.learner.audition.number;
        }
    }

    fn act(&mut self, ask: Ask<'_>, now: Now) -> Result<(), LearnError> {
        let Ask { scenes, random, actions } = ask;
        self.exploits = now.env_steps as f64 >= self.config.heads.until * now.of as f64;
        let epsilon = f64::from(self.epsilon());
        let Self { rules, columns, learner, running, seen, .. } = self;
        let agents = learner.tables.len();
        for (scene, actions) in scenes.scenes.iter().zip(actions.chunks_exact_mut(agents)) {
            let Scene { instance, state, begins, .. } = *scene;
            let Running { head, places, rows, audition, .. } = &mut running[instance];
            let is_tried = *audition > 0 && *audition == learner.audition.number;
            if begins {
                look(scenes.environment, columns, state, seen, places);
                learner.visit(places);
            }
            rows.clear();
            for (agent, (place, action)) in places.iter().zip(actions).enumerate() {
                let random = &mut random[instance];
                let row = learner.tables[agent].row_of(*place);
                rows.push(row);
                *action = if is_tried {
                    learner.best_action(agent, *place, Version::Tried)
                } else if chance(random, epsilon) {
                    below(random, ACTIONS) as u16
                } else {
                    liked(&learner.tables[agent].rows[row as usize], *head, rules, random)
                };
            }
        }
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let Self { config, rules, columns, learner, selector, running, seen, .. } = self;
        let Transition { environment, instance, actions, step, next, .. } = *transition;
        let running = &mut running[instance];
        look(environment, columns, next, seen, &mut running.places);
        let Running { places, rows, trail, .. } = running;
        let deed = Deed { rows, actions, next: places, is_end: step.terminated };
        learner.remember(rules, &deed, step.reward);
        trail.extend_from_slice(rows);
        if step.done() || trail.len() >= config.values.segment * rows.len() {
            learner.back_up(rules, trail);
            trail.clear();
        }
        running.episode_return += step.reward;
        running.discounted.add(step.reward, config.values.discount);
        if step.done() {
            selector.add(running.head, running.discounted.sum);
            learner.audition.add(running.audition, running.episode_return);
        }
        Ok(())
    }

    fn update(&mut self, _: &dyn Environment, now: Now) -> Result<Reports, LearnError> {
        if now.env_steps >= self.next_sweep || now.env_steps >= now.of {
            self.next_sweep = now.env_steps + self.config.values.sweep_every;
            self.learner.back_up_all(&self.rules);
        }
        Ok(Reports::default())
    }

    fn rates(&self, _: Now) -> Rates {
        Rates { epsilon: self.epsilon(), learning_rate: 1.0 / self.rules.memory }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(Greedy { team: self, seen: Observation::default(), places: Vec::new() })
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        Ok(deployed(&self.learner, &self.columns))
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        state.kept("tables", &mut self.learner)?;
        state.value("selector", &mut self.selector)?;
        state.value("running", &mut self.running)?;
        state.value("exploits", &mut self.exploits)?;
        state.value("next-sweep", &mut self.next_sweep)
    }
}

/// Agents that take what is worth most to the team.
struct Greedy<'a> {
    team: &'a MaExp,
    seen: Observation,
    places: Vec<Place>,
}

impl Act for Greedy<'_> {
    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<(), LearnError> {
        let Self { team, seen, places } = self;
        let (learner, mut actions) = (&team.learner, actions.iter_mut());
        for scene in scenes.scenes {
            look(scenes.environment, &team.columns, scene.state, seen, places);
            for ((agent, place), action) in places.iter().enumerate().zip(&mut actions) {
                *action = learner.best_action(agent, *place, learner.deployed());
            }
        }
        Ok(())
    }

    fn thoughts(&mut self, scenes: &Scenes<'_>, _: &[u16]) -> Vec<Thought> {
        let Self { team, seen, places } = self;
        let MaExp { learner, rules, columns, .. } = team;
        let mut thoughts = Vec::new();
        for scene in scenes.scenes {
            look(scenes.environment, columns, scene.state, seen, places);
            let of = |(agent, place): (usize, &Place)| thought(learner, rules, agent, *place);
            thoughts.extend(places.iter().enumerate().map(of));
        }
        thoughts
    }

    fn visits(&self) -> Vec<Vec<u32>> {
        self.team.learner.counts.all()
    }
}

/// How fast means of returns follow.
const RATE: f64 = 0.1;

/// Means of the discounted returns of episodes by the head that acted in them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Selector {
    /// What each head's episodes returned; none of heads that were never tried.
    pub means: Vec<Option<f64>>,
}

impl Selector {
    /// So many heads, none of which was tried.
    pub fn new(heads: usize) -> Self {
        Self { means: vec![None; heads] }
    }

    /// An episode ended in which a head acted.
    pub fn add(&mut self, head: usize, discounted: f64) {
        let mean = &mut self.means[head];
        *mean = Some(mean.map_or(discounted, |mean| mean + RATE * (discounted - mean)));
    }

    /// A head that was never tried, else with such a chance any, else one that returns much, by softmax.
    pub fn choose(&self, any: f64, temperature: f64, random: &mut Random) -> usize {
        let untried = self.means.iter().position(Option::is_none);
        if let Some(head) = untried {
            return head;
        }
        if chance(random, any) {
            return below(random, self.means.len());
        }
        by_weight(random, &shares(self.means.iter().flatten().copied(), temperature))
    }
}

/// What a deployed agent thinks where it is, and what its heads would pay and do there; nothing of them where it never
/// was.
pub(super) fn thought(learner: &Learner, rules: &Rules, agent: usize, place: Place) -> Thought {
    let scores = learner.utilities(agent, Some(place), learner.deployed()).to_vec();
    let mut heads = Vec::new();
    if let Some(row) = learner.tables[agent].find(place) {
        let paid = learner.paid(rules, agent, row);
        let score = |action: usize, head| row.score(action, head, &rules.weights);
        let better = |head| {
            move |one: &usize, other: &usize| score(*one, head).total_cmp(&score(*other, head))
        };
        let deployed = learner.best_action(agent, place, learner.deployed());
        heads.extend(rules.heads.iter().enumerate().map(|(head, explores)| {
            let acts = head + 1 == rules.heads.len();
            let likes = (0..ACTIONS).rev().max_by(better(head)).unwrap_or_default() as u16;
            Head {
                name: explores.map_or("none", Intrinsic::name).to_owned(),
                pays: paid[head],
                likes: if acts { deployed } else { likes },
                acts,
            }
        }));
    }
    Thought { scores, heads, ..Thought::default() }
}
