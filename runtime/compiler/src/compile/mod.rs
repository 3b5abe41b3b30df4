//! From the bytes of an ONNX file to a plan that was checked against it.

mod policy;
mod prove;

use sortie_bundle::{Recording, sha256};
use sortie_core::plan::{Network, Profile, Program, ProgramDraft, Proof};
use sortie_plans::{
    CompileError, CompileOptions, Compiled, NetworkFiles, NetworkSizes, ProposalFiles, report,
};

use crate::flat::wild_constant;
use crate::graph::{EntityRoles, Graph, Inputs, ProposalPart, TeamRoles};
use crate::lower::{
    AgentSizes, Choice, EntitySizes, Origin, assemble, lower_agent, lower_agent_int8,
    lower_entities, lower_proposals,
};
use crate::matching::{
    AgentLayers, match_agent, match_entities, match_proposals, match_team_value,
};
use crate::networks::Graphs;
use prove::prove;

pub use policy::compile_policy;
pub(crate) use policy::compile_recorded_policy;
#[cfg(test)]
pub(crate) use policy::prove_policy;
pub use prove::compare_with_files;

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

/// Compiles trunk, step and critic of an allocator that proposes to one plan, and proves it.
///
/// # Errors
/// As [`compile`].
pub fn compile_proposals(
    files: &ProposalFiles<'_>,
    options: &CompileOptions,
) -> Result<Compiled, CompileError> {
    let graphs = Graphs::read(&NetworkFiles::Proposals(*files))?;
    if options.profile == Profile::Int8 {
        return Err(CompileError::NoInt8 { what: "an allocator's network".into() });
    }
    finish(&graphs, &files.joined(), options, None)
}

fn compile_for(
    onnx: &[u8],
    options: &CompileOptions,
    examples: Option<&Recording>,
) -> Result<Compiled, CompileError> {
    finish(&Graphs::read(&NetworkFiles::One(onnx))?, onnx, options, examples)
}

/// Lowers graphs, and proves the plan by their files; `source` is what the plan is known by.
fn finish(
    graphs: &Graphs,
    source: &[u8],
    options: &CompileOptions,
    examples: Option<&Recording>,
) -> Result<Compiled, CompileError> {
    let Lowered { program, weights, sizes, network } = match graphs {
        Graphs::One(graph) => lower(graph, options, examples)?,
        Graphs::Proposals(graphs) => lower_three(graphs, options)?,
    };
    let NetworkSizes { network: kind, groups, .. } = network;
    let metadata = graphs.first().metadata.get("sortie.contract");
    let known = metadata.and_then(|hash| u64::from_str_radix(hash, 16).ok());
    let mut origin = Origin {
        source: sha256(source),
        profile: options.profile,
        network: kind,
        contract: options.contract.or(known).unwrap_or(0),
        t_max: match kind {
            Network::Entities | Network::Proposals => groups as u16,
            _ => options.t_max,
        },
        proof: Proof::NONE,
        action_mismatch: 0.0,
    };
    let draft = assemble(&program, &weights, sizes, &origin)?;
    let inputs = network.random_inputs(options.inputs, options.seed);
    let comparison = prove(&draft, graphs, inputs, options).map_err(|error| {
        let wild = graphs.all().iter().find_map(|graph| wild_constant(&graph.file));
        blamed_on(wild, error)
    })?;
    origin.proof = comparison.proof();
    origin.action_mismatch = comparison.action_mismatches as f32 / comparison.inputs.max(1) as f32;
    let bytes = assemble(&program, &weights, sizes, &origin)?;
    let program = program.to_bytes();
    let program = Program::read(program.as_slice())?;
    let report = report(&program, sizes.n_max, bytes.len(), &comparison);
    Ok(Compiled { bytes, report })
}

/// A difference is no fault of the compiler's where the file holds a number as no layer has.
fn blamed_on(wild: Option<(String, f32)>, error: CompileError) -> CompileError {
    let differs =
        matches!(error, CompileError::Wrong { .. } | CompileError::AnswersOtherwise { .. });
    match wild {
        Some((constant, weight)) if differs => {
            CompileError::WildWeight { constant, weight, error: error.into() }
        }
        _ => error,
    }
}

/// A network as a program.
struct Lowered {
    program: ProgramDraft,
    weights: Vec<u8>,
    sizes: AgentSizes,
    network: NetworkSizes,
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
    let mut network = NetworkSizes {
        network: Network::Agent,
        n_max,
        features: graph.columns,
        actions: graph.actions,
        memory: 0,
        relations: 0,
        groups: 0,
    };
    let layers = match graph.inputs {
        Inputs::Agent(roles) => {
            let features = options.features.or_else(|| graph.number("sortie.features"));
            sizes.features = features.unwrap_or(graph.columns);
            network.features = sizes.features;
            network.memory = roles.memory.map_or(0, |memory| memory.size);
            match_agent(graph)?
        }
        Inputs::TeamValue(TeamRoles { features, relations, .. }) => {
            let kind = Network::TeamValue;
            network = NetworkSizes { network: kind, features, relations, ..network };
            match_team_value(graph)?
        }
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
            let network = NetworkSizes { network: Network::Entities, groups, ..network };
            return Ok(Lowered { program, weights: weights.to_bytes(), sizes, network });
        }
    };
    let of_profile = (options.profile, examples);
    let (program, weights) = lower_layers(&layers, sizes, network.network, of_profile)?;
    Ok(Lowered { program, weights, sizes, network })
}

/// The same for trunk, step and critic.
fn lower_three(graphs: &[Graph; 3], options: &CompileOptions) -> Result<Lowered, CompileError> {
    let layers = match_proposals(graphs.each_ref())?;
    let (features, groups) = (layers.trunk.embed.matrix.inputs, layers.trunk.tasks.inputs);
    let (program, weights) = lower_proposals(&layers, options.n_max)?;
    let (n_max, actions) = (options.n_max, 1);
    let sizes = AgentSizes { n_max, features, actions, choice: Choice::Greedy };
    let (network, memory, relations) = (Network::Proposals, 0, 0);
    let network = NetworkSizes { network, n_max, features, actions, memory, relations, groups };
    Ok(Lowered { program, weights: weights.to_bytes(), sizes, network })
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
