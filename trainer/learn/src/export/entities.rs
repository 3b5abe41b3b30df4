//! Networks over all entities: critics, the trunks of allocators, and what a team at a subtask is worth
//! (`allocator_team_value.onnx`).

use super::attention::{
    AttentionNetwork, ExportError, Inputs, add_attention, add_head, add_network, add_second, axis,
};
use super::onnx::{Attribute, Dim, Element, Graph, metadata};

/// Whose rows a mean is taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Members {
    /// All present entities.
    Present,
    /// All agents; an absent one counts as a row of zeros, as in the hypernetworks (dissertation section 5.1).
    Agents,
}

/// A network in which every entity attends to every other.
#[derive(Clone, Copy, Debug)]
pub struct EntityNetwork<'a> {
    /// Features d of an entity.
    pub features: usize,
    /// Groups T that an entity may belong to, subtasks for instance.
    pub groups: usize,
    /// Hash of the contract that it was trained for.
    pub contract: u64,
    /// Whose rows the layers behind the attention see the mean of.
    pub members: Members,
    /// The layers: d features in, U values out.
    pub layers: AttentionNetwork<'a>,
}

/// Writes the network as ONNX: `entities [N, d], present [N], is_agent [N], groups [N, T] -> values [U],
/// attended [N, E], sums [T, E]`.
///
/// Present entities attend to each other. Two layers on the mean of their attended rows give the values; the sums
/// are those of the embeddings of every group's present entities.
pub fn entity_network_onnx(network: &EntityNetwork<'_>) -> Result<Vec<u8>, ExportError> {
    let EntityNetwork { features, groups, members, layers, .. } = network;
    let (want, got) = (*features, layers.inputs);
    if want != got {
        return Err(ExportError::Columns { want, got });
    }
    let mut graph = Graph::default();
    declare(&mut graph, network);
    let inputs = Inputs { rows: "entities", own: None, visible: "present" };
    let (embedding, rows) = add_attention(&mut graph, layers, inputs, true)?;
    let shown = shown_rows(&mut graph, "attended", &rows, "present");
    let mean = add_mean(&mut graph, *members, &rows, &shown);
    let base = add_second(&mut graph, layers, &mean)?;
    add_head(&mut graph, layers, &base, "values")?;
    add_sums(&mut graph, &embedding);
    let sizes = [("sortie.features", *features), ("sortie.groups", *groups)];
    let metadata = metadata("entities", network.contract, sizes);
    let doc = "Values of all entities together. Absent ones have no influence.";
    Ok(graph.into_model("entities", doc, &metadata))
}

fn declare(graph: &mut Graph, network: &EntityNetwork<'_>) {
    let EntityNetwork { features, groups, layers, .. } = *network;
    let (n, width) = (Dim::Symbol("N"), Dim::Fixed(layers.width));
    let rows = "Features of every entity.";
    graph.input("entities", Element::Float, &[n, Dim::Fixed(features)], rows);
    graph.input("present", Element::Bool, &[n], "True where the entity exists.");
    graph.input("is_agent", Element::Bool, &[n], "True for agents, present or not.");
    let doc = "True where the entity belongs to the group.";
    graph.input("groups", Element::Bool, &[n, Dim::Fixed(groups)], doc);
    graph.output("values", Element::Float, &[Dim::Fixed(layers.outputs)], "The values.");
    let doc = "Rows after the attention, zeros for absent entities.";
    graph.output("attended", Element::Float, &[n, width], doc);
    let doc = "Sums of the embeddings of every group's present entities.";
    graph.output("sums", Element::Float, &[Dim::Fixed(groups), width], doc);
}

/// The rows where `mask` holds, zeros elsewhere: no value of a hidden row can get through.
fn shown_rows(graph: &mut Graph, name: &str, rows: &str, mask: &str) -> String {
    let column = graph.integers(&format!("{name}.axis"), &[1]).to_owned();
    let nothing = graph.floats(&format!("{name}.nothing"), &[], &[0.0]).to_owned();
    let mask = graph.node(&format!("{name}.mask"), "Unsqueeze", &[mask, &column], &[]);
    graph.node(name, "Where", &[&mask, rows, &nothing], &[])
}

/// The mean `[1, E]` of the members' rows; zeros where there is no member.
fn add_mean(graph: &mut Graph, members: Members, rows: &str, shown: &str) -> String {
    let (rows, counted) = match members {
        Members::Present => (shown.to_owned(), "present"),
        Members::Agents => {
            let mask = graph.node("mean.members", "And", &["present", "is_agent"], &[]);
            (shown_rows(graph, "mean.rows", rows, &mask), "is_agent")
        }
    };
    let to_float = [Attribute::Int("to", Element::Float.id())];
    let keep = [Attribute::Int("keepdims", 1)];
    let first = graph.integers("mean.axis", &[0]);
    let one = graph.floats("mean.one", &[], &[1.0]);
    let sum = graph.node("mean.sum", "ReduceSum", &[&rows, first], &keep);
    let number = graph.node("mean.counted", "Cast", &[counted], &to_float);
    let count = graph.node("mean.count", "ReduceSum", &[&number, first], &keep);
    let count = graph.node("mean.divisor", "Max", &[&count, one], &[]);
    graph.node("mean", "Div", &[&sum, &count], &[])
}

/// The sums `[T, E]` of the present entities' embeddings by group.
fn add_sums(graph: &mut Graph, embedding: &str) {
    let to_float = [Attribute::Int("to", Element::Float.id())];
    let shown = shown_rows(graph, "sums.rows", embedding, "present");
    let belongs = graph.node("sums.belongs", "Cast", &["groups"], &to_float);
    let order = [Attribute::Ints("perm", &[1, 0])];
    let belongs = graph.node("sums.belongs.ordered", "Transpose", &[&belongs], &order);
    graph.node("sums", "MatMul", &[&belongs, &shown], &[]);
}

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
    let inputs = Inputs { rows: "rows", own: Some("own"), visible: "visible" };
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
        ("in_task", "True for the subtask's rows; the first forms the query."),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::attention::{Layer, Layout, Matrix};

    const FEATURES: usize = 7;

    /// Random weights of the given width, heads and outputs.
    fn export(
        [width, heads, outputs, groups]: [usize; 4],
        members: Members,
        features: usize,
    ) -> Result<Vec<u8>, ExportError> {
        let mut state = 11_u32;
        let mut tensor = |count: usize| -> Vec<f32> {
            let mut next = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) as f32 / (1 << 24) as f32 - 0.5
            };
            (0..count).map(|_| next()).collect()
        };
        fn matrix(values: &[f32]) -> Matrix<'_> {
            Matrix { values, layout: Layout::InputsFirst }
        }
        fn layer((weight, bias): &(Vec<f32>, Vec<f32>)) -> Layer<'_> {
            Layer { weight: matrix(weight), bias }
        }
        let base = 9;
        let sizes = [(FEATURES, width), (width, width), (width, base), (base, outputs)];
        let layers = sizes.map(|(inputs, outputs)| (tensor(inputs * outputs), tensor(outputs)));
        let [fc1, attention_out, fc2, head] = layers.each_ref().map(layer);
        let attention_in = tensor(3 * width * width);
        let attention_in = matrix(&attention_in);
        let inputs = FEATURES;
        let layers = AttentionNetwork {
            inputs,
            width,
            heads,
            base,
            outputs,
            fc1,
            attention_in,
            attention_out,
            skip: None,
            fc2: Some(fc2),
            head,
            pointing: None,
        };
        let contract = 0x0123_4567_89ab_cdef;
        entity_network_onnx(&EntityNetwork { features, groups, contract, members, layers })
    }

    fn assert_recorded(name: &str, written: &[u8]) {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
        let recorded = std::fs::read(format!("{root}{name}")).unwrap();
        assert!(written == recorded, "the exported bytes of {name} changed");
    }

    #[test]
    fn networks_become_the_recorded_files() {
        let small = export([16, 2, 1, 3], Members::Agents, FEATURES).unwrap();
        assert_recorded("entities_small.onnx", &small);
        let odd = export([15, 5, 4, 5], Members::Present, FEATURES).unwrap();
        assert_recorded("entities_odd_sizes.onnx", &odd);
    }

    #[test]
    fn features_that_are_not_the_networks_are_refused() {
        let error = export([16, 2, 1, 3], Members::Agents, 6).unwrap_err();
        assert_eq!(error, ExportError::Columns { want: 6, got: 7 });
    }
}
