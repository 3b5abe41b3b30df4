//! From the bytes of an ONNX file to a plan that was checked against it.

mod parity;
mod policy;
mod proposals;

use sortie_bundle::{Recording, sha256};
use sortie_core::plan::{Network, Profile, Program, ProgramDraft};
use sortie_plans::{
    Comparison, CompileError, CompileOptions, Compiled, TOLERANCE, random_entities,
    random_observations, random_team_queries, report,
};

use crate::graph::{EntityRoles, Graph, Inputs, ProposalPart, TeamRoles};
use crate::lower::{
    AgentSizes, Choice, EntitySizes, Origin, assemble, lower_agent, lower_agent_int8,
    lower_entities,
};
use crate::matching::{AgentLayers, match_agent, match_entities, match_team_value};
use parity::{entities_against_graph, plan_against_graph, team_values_against_graph};

pub use parity::{compare_entities_with_graph, compare_team_values_with_graph, compare_with_graph};
pub use policy::compile_policy;
#[cfg(test)]
pub(crate) use policy::prove_policy;
pub use proposals::{compare_proposals_with_graphs, compile_proposals};

/// Compiles an ONNX file, a network of an agent, of an allocator or over all entities, and proves the plan against it.
///
/// A damaged file can make the parser allocate without bound, loop or overflow the stack: files of strangers are
/// for a [`sortie_plans::CompilerProcess`].
pub fn compile(onnx: &[u8], options: &CompileOptions) -> Result<Compiled, CompileError> {
    compile_for(onnx, options, None)
}

/// As [`compile`]; the weights of a plan of profile int8 are not the nearest, but rounded so that its products err
/// little on these observations.
pub fn compile_rounded(
    onnx: &[u8],
    options: &CompileOptions,
    examples: &Recording,
) -> Result<Compiled, CompileError> {
    compile_for(onnx, options, Some(examples))
}

fn compile_for(
    onnx: &[u8],
    options: &CompileOptions,
    examples: Option<&Recording>,
) -> Result<Compiled, CompileError> {
    let graph = Graph::read(onnx)?;
    let Lowered { program, weights, sizes, network } = lower(&graph, options, examples)?;
    let metadata = graph.metadata.get("sortie.contract");
    let known = metadata.and_then(|hash| u64::from_str_radix(hash, 16).ok());
    let mut origin = Origin {
        source: sha256(onnx),
        profile: options.profile,
        network,
        contract: options.contract.or(known).unwrap_or(0),
        t_max: match graph.inputs {
            Inputs::Entities(EntityRoles { group_count, .. }) => group_count as u16,
            _ => options.t_max,
        },
        max_error: 0.0,
        action_mismatch: 0.0,
    };
    let draft = assemble(&program, &weights, sizes, &origin)?;
    let comparison = prove(&draft, &graph, sizes, options)?;
    origin.max_error = comparison.max_rel_error;
    origin.action_mismatch = comparison.action_mismatches as f32 / comparison.inputs.max(1) as f32;
    let bytes = assemble(&program, &weights, sizes, &origin)?;
    let program = program.to_bytes();
    let program = Program::read(program.as_slice())?;
    let report = report(&program, sizes.n_max, bytes.len(), &comparison);
    Ok(Compiled { bytes, report })
}

/// A network as a program.
struct Lowered {
    program: ProgramDraft,
    weights: Vec<u8>,
    sizes: AgentSizes,
    network: Network,
}

/// Matches a graph and lowers what was found.
fn lower(
    graph: &Graph,
    options: &CompileOptions,
    examples: Option<&Recording>,
) -> Result<Lowered, CompileError> {
    let n_max = options.n_max;
    let drawn = graph.metadata.get("sortie.choice").is_some_and(|choice| choice == "sample");
    let choice = if drawn { Choice::Drawn } else { Choice::Greedy };
    let mut sizes = AgentSizes { n_max, features: graph.columns, actions: graph.actions, choice };
    let (layers, network) = match graph.inputs {
        Inputs::Agent(_) => {
            let features = options.features.or_else(|| graph.number("sortie.features"));
            sizes.features = features.unwrap_or(graph.columns);
            (match_agent(graph)?, Network::Agent)
        }
        Inputs::TeamValue(_) => (match_team_value(graph)?, Network::TeamValue),
        Inputs::Proposals(roles) => return Err(part_alone(roles.part)),
        Inputs::Entities(EntityRoles { group_count: groups, .. }) => {
            // No action is chosen, but a plan has one at least.
            sizes.actions = 1;
            let layers = match_entities(graph)?;
            let of_entities = EntitySizes { n_max, features: graph.columns, groups };
            let (program, weights) = lower_entities(&layers, of_entities)?;
            if options.profile == Profile::Int8 {
                return Err(CompileError::NoInt8 { what: "a network over all entities".into() });
            }
            return Ok(Lowered {
                program,
                weights: weights.to_bytes(),
                sizes,
                network: Network::Entities,
            });
        }
    };
    let (program, weights) = lower_layers(&layers, sizes, network, (options.profile, examples))?;
    Ok(Lowered { program, weights, sizes, network })
}

/// A part of an allocator that proposes is no plan by itself.
fn part_alone(part: ProposalPart) -> CompileError {
    CompileError::PartAlone { part: part.name().into() }
}

/// Lowers a network to operators of the profile, and their weights as the plan holds them.
fn lower_layers(
    layers: &AgentLayers,
    sizes: AgentSizes,
    network: Network,
    (profile, examples): (Profile, Option<&Recording>),
) -> Result<(ProgramDraft, Vec<u8>), CompileError> {
    if profile != Profile::Int8 {
        return lower_agent(layers, sizes).map(|(program, weights)| (program, weights.to_bytes()));
    }
    if network != Network::Agent {
        return Err(CompileError::NoInt8 { what: "an allocator's network".into() });
    }
    lower_agent_int8(layers, sizes, examples).map(|(program, weights)| (program, weights.bytes))
}

/// Compares a plan with its graph on random inputs, and refuses one that differs; of an int8 plan only the error is
/// measured, as its actions in the real environment decide about it.
fn prove(
    plan: &[u8],
    graph: &Graph,
    sizes: AgentSizes,
    options: &CompileOptions,
) -> Result<Comparison, CompileError> {
    let CompileOptions { inputs, n_max, seed, .. } = *options;
    let comparison = match graph.inputs {
        Inputs::Agent(_) => {
            let AgentSizes { features, actions, .. } = sizes;
            let observations = random_observations(inputs, n_max, features, actions, seed);
            plan_against_graph(plan, graph, &observations, seed)?
        }
        Inputs::TeamValue(TeamRoles { features, relations, .. }) => {
            let queries = random_team_queries(inputs, n_max, features, relations, seed);
            team_values_against_graph(plan, graph, &queries)?
        }
        Inputs::Proposals(roles) => return Err(part_alone(roles.part)),
        Inputs::Entities(EntityRoles { group_count, .. }) => {
            let steps = random_entities(inputs, n_max, sizes.features, group_count, seed);
            entities_against_graph(plan, graph, &steps)?
        }
    };
    let error = comparison.max_rel_error;
    if error.is_nan() || error > TOLERANCE && options.profile != Profile::Int8 {
        return Err(CompileError::Differs {
            error,
            limit: TOLERANCE,
            input: comparison.worst_input,
            seed,
        });
    }
    Ok(comparison)
}
