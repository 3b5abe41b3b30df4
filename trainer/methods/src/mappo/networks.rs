//! What actor and critic are shown of states, and what they make of it.

use std::ops::Range;

use sortie_envs::{ActionSet, AgentSet, EntitySet, Environment, Observation, Shape, Spec, View};
use sortie_learn::export::DeployedAgents;
use sortie_learn::networks::{self, AgentShape, EntityAgent, EntityBatch, LookShape, Targets};
use sortie_nn::layers::split_attention::HEADS;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Parameters, Pass, Var};

use super::{NetworkConfig, Sees};
use crate::actor_critic::acting::{Actors, Inputs, deployed};
use crate::actor_critic::groups::{Group, Groups};
use crate::actor_critic::policies::{Policies, PolicyShape};

/// States side by side. Agents that do not act are shown to others, and make no decision.
#[derive(Debug, Default)]
pub(super) struct Shown {
    /// Entities; of vectors the rows of the agents that act.
    batch: EntityBatch,
    /// The same rows of vectors in full, and what vectors tell of each state.
    own: Vec<f32>,
    states: Vec<f32>,
    seen: Observation,
}

impl Shown {
    /// Forgets all states, keeps the memory.
    pub(super) fn clear(&mut self) {
        self.batch.clear();
        self.states.clear();
    }

    /// Adds a state; returns who acts in it. Where nobody does there is nothing to be shown.
    pub(super) fn push(&mut self, environment: &dyn Environment, state: &[u8]) -> AgentSet {
        let Self { batch, states, seen, .. } = self;
        environment.observe(state, 0, EntitySet::MAX, seen);
        let (acting, spec) = (seen.acting(), environment.spec());
        if acting == 0 {
            return acting;
        }
        if spec.view == View::Vectors {
            for entity in rows_of_state(spec) {
                let start = states.len();
                states.resize(start + spec.shape.features, 0.0);
                if seen.entities >> entity & 1 == 1 {
                    seen.rows.write_dense(seen.row_of(entity), &mut states[start..]);
                }
            }
            seen.present = acting.into();
        }
        batch.push(seen);
        acting
    }

    /// Ends the pushing.
    pub(super) fn finish(&mut self, spec: &Spec) {
        let targets = Targets::of(spec);
        self.batch.aim_at(targets.entities(), targets.pairs());
        self.batch.finish(false);
        if spec.view == View::Vectors {
            self.batch.seen().rows.write_all(spec.shape.features, &mut self.own);
        }
    }

    /// What each agent of the state that was pushed last may do, those too that do not act.
    pub(super) fn latest(&self) -> &[ActionSet] {
        &self.seen.available
    }

    /// What each agent may do that acts.
    pub(super) fn available(&self) -> &[ActionSet] {
        self.batch.available()
    }
}

/// The rows that tell of a state: the one behind the agents', or those of all agents where there is none.
fn rows_of_state(spec: &Spec) -> Range<usize> {
    let Shape { agents, entities, .. } = spec.shape;
    if entities > agents { agents..entities } else { 0..agents }
}

/// What is added to scores so that actions that are not available have no chance.
pub(super) fn closed(available: ActionSet) -> impl Iterator<Item = f32> {
    (0..ActionSet::BITS).map(move |action| if available >> action & 1 == 1 { 0.0 } else { -1e9 })
}

/// A network that makes numbers for each agent.
#[derive(Debug)]
pub(super) struct Network {
    body: Body,
    /// Whether it makes them of the state, the same for the whole team.
    is_central: bool,
    outputs: usize,
}

#[derive(Debug)]
enum Body {
    Entities(Box<EntityAgent>),
    Vectors(Groups, Policies),
}

impl Network {
    /// Draws the actor, which scores actions, or a critic of what it sees, which makes a value.
    pub(super) fn new(
        config: &NetworkConfig,
        spec: &Spec,
        critic: Option<Sees>,
        random: &mut Generator,
    ) -> (Self, Parameters) {
        let is_central = critic == Some(Sees::State);
        let (outputs, targets) = match critic {
            None => (spec.shape.actions, Targets::of(spec)),
            Some(_) => (1, Targets::default()),
        };
        let NetworkConfig { width, active_inputs, .. } = *config;
        let Shape { agents, features: input, .. } = spec.shape;
        let (body, parameters) = if spec.view == View::Entities {
            let active_inputs = if active_inputs == 0 { input } else { active_inputs };
            let looking = LookShape { input, active_inputs, width, heads: HEADS };
            let shape = AgentShape { looking, actions: outputs, skip: true, memory: 0, targets };
            let mut parameters = Parameters::default();
            let agents = EntityAgent::new(&mut parameters, shape, random);
            (Body::Entities(Box::new(agents)), parameters)
        } else {
            let observed = if is_central { input * rows_of_state(spec).len() } else { input };
            let group = Group { agents: 0..agents, observed, identity: false, actions: outputs };
            let groups = Groups(vec![group]);
            let shape = PolicyShape { widths: [width; 2], heads: 1, slope: 0.0 };
            let (layers, parameters) = Policies::new(shape, &groups, random);
            (Body::Vectors(groups, layers), parameters)
        };
        (Self { body, is_central, outputs }, parameters)
    }

    /// The numbers `[agents, outputs]` of all that act.
    pub(super) fn numbers(&self, pass: &mut Pass<'_>, shown: &Shown) -> Var {
        let (batch, teams) = (&shown.batch, shown.batch.teams());
        let of = &teams.numbers[..batch.agents()];
        let found = match &self.body {
            Body::Entities(agents) if self.is_central => {
                let found = agents.utilities(pass, batch, batch.known(), &mut []);
                pass.mean_by(found, of, teams.sizes.len())
            }
            Body::Entities(agents) => agents.utilities(pass, batch, batch.seen(), &mut []),
            Body::Vectors(_, layers) => {
                let rows = if self.is_central { &shown.states } else { &shown.own };
                let mut found = Vec::new();
                layers.score(pass, 0, rows, 0..1, &mut found);
                found[0]
            }
        };
        if self.is_central { pass.gather(found, of) } else { found }
    }

    /// The agents by these weights as they are deployed.
    pub(super) fn deployed<'a>(&'a self, weights: &'a [f32]) -> DeployedAgents<'a> {
        match &self.body {
            Body::Entities(agents) => networks::deployed(agents, weights),
            Body::Vectors(groups, policies) => {
                let inputs = Inputs { scale: 1.0, running: None };
                deployed(Actors { groups, inputs, policies, head: 0, weights }, self.outputs)
            }
        }
    }
}
