//! `allocator_team_value.onnx`: what a team at a subtask is worth.

use super::attention::{AttentionNetwork, ExportError, Inputs, add_network, axis};
use super::onnx::{Attribute, Dim, Element, Graph, metadata};

/// The team-value network of an allocator.
#[derive(Clone, Copy, Debug)]
pub struct TeamValueExport<'a> {
    /// Features d of an entity.
    pub features: usize,
    /// Columns F of the relation of an entity to the subtask.
    pub relations: usize,
    /// Hash of the contract that it was trained for.
    pub contract: u64,
    /// The layers: d features, the subtask's flag, team flag and F relations in, one value out.
    pub layers: AttentionNetwork<'a>,
}

/// Writes the network as ONNX: `entities [N, d], present [N], is_agent [N], in_task [N], open [N],
/// team [N], relation [N, F] -> value [1]`.
///
/// The first row of the subtask forms the query, which attends to the present agents and to the
/// present rows of open subtasks.
pub fn team_value_onnx(network: &TeamValueExport<'_>) -> Result<Vec<u8>, ExportError> {
    let TeamValueExport { features, relations, layers, .. } = network;
    let (want, got) = (features + 2 + relations, layers.inputs);
    if want != got {
        return Err(ExportError::Columns { want, got });
    }
    let mut graph = Graph::default();
    declare_team_value(&mut graph, *features, *relations);
    let inputs = Inputs { rows: "rows", own: "own", visible: "visible" };
    add_inputs(&mut graph);
    add_network(&mut graph, layers, inputs, "value")?;
    let sizes = [("sortie.features", *features), ("sortie.relations", *relations)];
    let metadata = metadata("team-value", network.contract, sizes);
    let doc = "The value of giving a team, which may be empty, to a subtask. Absent entities and those of \
               closed subtasks have no influence.";
    Ok(graph.into_model("allocator_team_value", doc, &metadata))
}

fn declare_team_value(graph: &mut Graph, features: usize, relations: usize) {
    let n = Dim::Symbol("N");
    let rows = "Features of every entity.";
    graph.input("entities", Element::Float, &[n, Dim::Fixed(features)], rows);
    for (name, doc) in [
        ("present", "True where the entity exists."),
        ("is_agent", "True for agents."),
        ("in_task", "True for the subtask's own row; it forms the query."),
        ("open", "True for rows of open subtasks, the one in question among them."),
        ("team", "True for the agents of the team."),
    ] {
        graph.input(name, Element::Bool, &[n], doc);
    }
    let doc = "How each entity relates to the subtask; zeros in the subtask's own row.";
    graph.input("relation", Element::Float, &[n, Dim::Fixed(relations)], doc);
    graph.output("value", Element::Float, &[Dim::Fixed(1)], "The value of the team.");
}

/// Joins the columns, finds the own row and what it attends to.
fn add_inputs(graph: &mut Graph) {
    let column = graph.integers("rows.column", &[1]);
    let to_float = [Attribute::Int("to", Element::Float.id())];
    let mut flag = |name: &str, mask: &str| {
        let number = graph.node(&format!("{name}.number"), "Cast", &[mask], &to_float);
        (graph.node(name, "Unsqueeze", &[&number, column], &[]), number)
    };
    let (own, own_number) = flag("rows.own", "in_task");
    let (team, _) = flag("rows.team", "team");
    graph.node("rows", "Concat", &["entities", &own, &team, "relation"], &[axis(1)]);
    graph.node("own", "ArgMax", &[&own_number], &[axis(0), Attribute::Int("keepdims", 1)]);
    graph.node("visible.kind", "Or", &["is_agent", "open"], &[]);
    graph.node("visible", "And", &["present", "visible.kind"], &[]);
}
