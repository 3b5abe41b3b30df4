//! What actor and critic are shown of states, and what they make of it.

use sortie_envs::View;
use sortie_envs::{ActionSet, AgentSet, EntitySet, Environment, Observation, Random, Shape, Spec};
use sortie_learn::export::DeployedAgents;
use sortie_learn::networks::{AgentShape, EntityAgent, EntityBatch, LookShape, Targets};
use sortie_nn::tape::{Parameters, Pass, Var};

use super::{NetworkConfig, Sees};
use crate::actor_critic::acting::{Actors, Inputs};
use crate::actor_critic::deployed;
use crate::actor_critic::groups::{Group, Groups};
use crate::actor_critic::policies::{Policies, PolicyShape};

/// States side by side. Agents that do not act are shown to others, but have no row.
#[derive(Debug, Default)]
pub(super) struct Shown {
    /// Entities; of vectors the rows of the agents that act.
    batch: EntityBatch,
    /// The same rows of vectors in full.
    own: Vec<f32>,
    /// What vectors tell of each state.
    states: Vec<f32>,
    seen: Observation,
}

impl Shown {
    /// Forgets all states, keeps the memory.
    pub(super) fn clear(&mut self) {
        self.batch.clear();
        self.states.clear();
    }

    /// Adds a state as it looks under a symmetry; returns who acts in it. Where nobody does there is nothing to show.
    pub(super) fn push(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        turn: usize,
    ) -> AgentSet {
        environment.observe(state, turn, EntitySet::MAX, &mut self.seen);
        let acting = self.seen.acting();
        if acting == 0 {
            return acting;
        }
        if environment.spec().view == View::Vectors {
            self.push_state(environment.spec());
            self.seen.present = acting.into();
        }
        self.batch.push(&self.seen);
        acting
    }

    fn push_state(&mut self, spec: &Spec) {
        let Self { seen, states, .. } = self;
        for entity in rows_of_state(spec) {
            let start = states.len();
            states.resize(start + spec.shape.features, 0.0);
            if seen.entities >> entity & 1 == 1 {
                seen.rows.write_dense(seen.row_of(entity), &mut states[start..]);
            }
        }
    }

    /// Ends the pushing.
    pub(super) fn finish(&mut self, spec: &Spec) {
        let Self { batch, own, .. } = self;
        let targets = Targets::of(spec);
        batch.aim_at(targets.entities(), targets.pairs());
        batch.finish(false);
        if spec.view == View::Vectors {
            batch.seen().rows.write_all(spec.shape.features, own);
        }
    }

    /// What every agent of the state that was pushed last may do, those too that do not act.
    pub(super) fn latest(&self) -> &[ActionSet] {
        &self.seen.available
    }

    /// How many agents act in all states.
    pub(super) fn agents(&self) -> usize {
        self.batch.agents()
    }

    /// What each of them may do.
    pub(super) fn available(&self) -> &[ActionSet] {
        self.batch.available()
    }
}

/// The rows that tell of a state: the one behind the agents', or those of all agents where there is none.
fn rows_of_state(spec: &Spec) -> std::ops::Range<usize> {
    let Shape { agents, entities, .. } = spec.shape;
    if entities > agents { agents..entities } else { 0..agents }
}

/// A network that makes numbers for each agent.
#[derive(Debug)]
pub(super) struct Network {
    body: Body,
    /// Whether it makes them of the whole state, the same for the whole team.
    is_central: bool,
    actions: usize,
}

#[derive(Debug)]
enum Body {
    Entities(EntityAgent),
    Vectors(Groups, Policies),
}

impl Network {
    /// Draws the actor, which scores actions.
    pub(super) fn actor(
        config: &NetworkConfig,
        spec: &Spec,
        random: &mut Random,
    ) -> (Self, Parameters) {
        Self::new(config, spec, (false, spec.shape.actions, Targets::of(spec)), random)
    }

    /// Draws the critic, which values states.
    pub(super) fn critic(
        config: &NetworkConfig,
        spec: &Spec,
        random: &mut Random,
    ) -> (Self, Parameters) {
        Self::new(config, spec, (config.critic == Sees::State, 1, Targets::default()), random)
    }

    fn new(
        config: &NetworkConfig,
        spec: &Spec,
        (is_central, outputs, targets): (bool, usize, Targets),
        random: &mut Random,
    ) -> (Self, Parameters) {
        let NetworkConfig { width, heads, active_inputs, .. } = *config;
        let Shape { agents, features, .. } = spec.shape;
        let (body, parameters) = if spec.view == View::Entities {
            let active_inputs = if active_inputs == 0 { features } else { active_inputs };
            let looking = LookShape { input: features, active_inputs, width, heads };
            let shape = AgentShape { looking, actions: outputs, skip: true, memory: 0, targets };
            let mut parameters = Parameters::default();
            (Body::Entities(EntityAgent::new(&mut parameters, shape, random)), parameters)
        } else {
            let rows = if is_central { rows_of_state(spec).len() } else { 1 };
            let (observed, identity) = (rows * features, false);
            let group = Group { agents: 0..agents, observed, identity, actions: outputs };
            let groups = Groups(vec![group]);
            let shape = PolicyShape { widths: [width; 2], heads: 1, slope: 0.0 };
            let (layers, parameters) = Policies::new(shape, &groups, random);
            (Body::Vectors(groups, layers), parameters)
        };
        (Self { body, is_central, actions: outputs }, parameters)
    }

    /// The numbers `[agents, U]` of all that act.
    pub(super) fn numbers(&self, pass: &mut Pass<'_>, shown: &Shown) -> Var {
        let (batch, teams) = (&shown.batch, shown.batch.teams());
        let numbers = &teams.numbers[..batch.agents()];
        let found = match &self.body {
            Body::Entities(agents) => {
                let view = if self.is_central { batch.known() } else { batch.seen() };
                let found = agents.utilities(pass, batch, view, &mut []);
                // Each looks at the state with eyes of its own; their mean is the state's.
                let states = teams.sizes.len();
                if self.is_central { pass.mean_by(found, numbers, states) } else { found }
            }
            Body::Vectors(_, layers) => {
                let rows = if self.is_central { &shown.states } else { &shown.own };
                let mut found = Vec::new();
                layers.score(pass, 0, rows, 0..1, &mut found);
                found[0]
            }
        };
        if self.is_central { pass.gather(found, numbers) } else { found }
    }

    /// The agents by these weights as they are deployed.
    pub(super) fn deployed<'a>(&'a self, weights: &'a [f32]) -> DeployedAgents<'a> {
        match &self.body {
            Body::Entities(agents) => sortie_learn::networks::deployed(agents, weights),
            Body::Vectors(groups, policies) => {
                let inputs = Inputs { scale: 1.0, running: None };
                let actors = Actors { groups, inputs, policies, head: 0, weights };
                deployed::deployed(actors, self.actions)
            }
        }
    }
}
