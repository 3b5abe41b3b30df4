//! Patterns on the typed graph, recognised by structure and never by name.

mod agent;
mod entities;
mod gru;
mod pointing;
mod proposals;

pub(crate) use agent::{AgentLayers, Step, match_agent, match_team_value};
pub(crate) use entities::{AllAttention, EntityLayers, EntityStep, match_entities};
pub(crate) use gru::{GruLayers, as_matrix};
pub(crate) use pointing::aimed_at;
pub(crate) use proposals::{
    CriticLayers, ProposalLayers, StepLayers, TrunkLayers, match_proposals,
};
pub(crate) use sortie_plans::{Layer, Matrix};
