//! The truth about a network: its file's nodes one by one, in double precision.
//!
//! Nothing here is shared with what it judges. Plans are lowered from tract's reading of a file, after its optimiser
//! and after rewriting by this crate; the reference evaluator reads the nodes as they stand in the file, by the
//! specification of ONNX's operators. It is made to be read beside that specification, not to be fast.

mod control;
mod elementwise;
mod gathers;
mod moves;
mod noise;
mod products;
mod quantised;
mod recurrent;
mod reductions;
mod tensor;
mod truth;

use std::collections::HashMap;
use std::sync::Arc;

use tract_onnx::pb::{AttributeProto, GraphProto, ModelProto, NodeProto};

pub(crate) use noise::Noise;
pub(crate) use tensor::Tensor;
use tensor::{Failure, count};
pub(crate) use truth::{RUNS, Runs, truth};

/// Values by name.
type Values = HashMap<String, Arc<Tensor>>;

/// The version of the operators of a file that does not say which it uses.
const USUAL_VERSION: i64 = 17;

/// A file, ready to be evaluated.
#[derive(Debug)]
pub(crate) struct Reference {
    graph: GraphProto,
    version: i64,
    stored: Values,
}

impl Reference {
    /// Reads what a file stores, and computes what follows from it alone.
    pub(crate) fn new(file: &ModelProto) -> Result<Self, String> {
        let mut graph = file.graph.clone().unwrap_or_default();
        let own = file.opset_import.iter().find(|set| ["", "ai.onnx"].contains(&&*set.domain));
        let version = own.map_or(USUAL_VERSION, |set| set.version);
        let mut stored = stored(&graph, &Values::new())?;
        let (nodes, mut left) = (std::mem::take(&mut graph.node), Vec::new());
        for node in nodes.into_iter().flat_map(quantised::parted) {
            // Graphs inside a node may read anything.
            let is_plain = node.attribute.iter().all(|attribute| attribute.g.is_none());
            let is_stored = |name: &String| name.is_empty() || stored.contains_key(name);
            if is_plain && node.input.iter().all(is_stored) {
                Run { version, noise: None }.nodes(&[node], &mut stored)?;
            } else {
                left.push(node);
            }
        }
        graph.node = left;
        Ok(Self { graph, version, stored })
    }

    /// The wanted outputs for some inputs; with noise as an engine's that rounds behind every node.
    pub(crate) fn run(
        &self,
        inputs: impl IntoIterator<Item = (String, Tensor)>,
        wanted: &[String],
        noise: Option<&mut Noise>,
    ) -> Result<Vec<Tensor>, String> {
        let mut values = self.stored.clone();
        values.extend(inputs.into_iter().map(|(name, tensor)| (name, Arc::new(tensor))));
        let mut run = Run { version: self.version, noise };
        run.nodes(&self.graph.node, &mut values)?;
        let output = |name: &String| {
            let value = values.get(name).ok_or_else(|| format!("no node computes `{name}`"))?;
            Ok(Tensor::clone(value))
        };
        wanted.iter().map(output).collect()
    }
}

/// What a graph stores, beside what is known around it.
fn stored(graph: &GraphProto, around: &Values) -> Result<Values, String> {
    let mut values = around.clone();
    for proto in &graph.initializer {
        let tensor = Tensor::read(proto).map_err(|what| format!("`{}` {what}", proto.name))?;
        values.insert(proto.name.clone(), Arc::new(tensor));
    }
    Ok(values)
}

/// An evaluation.
struct Run<'a> {
    version: i64,
    noise: Option<&'a mut Noise>,
}

impl Run<'_> {
    /// Evaluates nodes, which stand in an order in which each finds its inputs computed.
    fn nodes(&mut self, nodes: &[NodeProto], values: &mut Values) -> Result<(), String> {
        for node in nodes {
            let of_node = |what: Failure| {
                format!("node `{}` of operator {}: {what}", node.name, node.op_type)
            };
            let found = match self.control(node, values)? {
                Some(found) => found,
                None => {
                    let call = Call::of(node, self.version, values).map_err(of_node)?;
                    let found = call.evaluate().map_err(of_node)?;
                    match &mut self.noise {
                        Some(noise) => noise.behind(&call, found).map_err(of_node)?,
                        None => found,
                    }
                }
            };
            for (name, tensor) in node.output.iter().zip(found) {
                values.insert(name.clone(), Arc::new(tensor));
            }
        }
        Ok(())
    }
}

/// A node with its inputs.
pub(crate) struct Call<'a> {
    node: &'a NodeProto,
    /// The version of ONNX's operators.
    version: i64,
    inputs: Vec<Option<Arc<Tensor>>>,
}

impl<'a> Call<'a> {
    fn of(node: &'a NodeProto, version: i64, values: &Values) -> Result<Self, Failure> {
        let input = |name: &String| {
            if name.is_empty() {
                return Ok(None);
            }
            let missing = || Failure::from(format!("nothing computes its input `{name}`"));
            values.get(name).cloned().map(Some).ok_or_else(missing)
        };
        let inputs = node.input.iter().map(input).collect::<Result<_, _>>()?;
        Ok(Self { node, version, inputs })
    }

    /// The same node with other inputs.
    fn with(&self, inputs: Vec<Option<Arc<Tensor>>>) -> Self {
        Self { node: self.node, version: self.version, inputs }
    }

    fn operator(&self) -> &'a str {
        &self.node.op_type
    }

    fn input(&self, index: usize) -> Result<&Tensor, Failure> {
        self.given(index).ok_or_else(|| format!("has no input {index}").into())
    }

    /// An input that may be left out.
    fn given(&self, index: usize) -> Option<&Tensor> {
        self.inputs.get(index).and_then(|input| input.as_deref())
    }

    fn attribute(&self, name: &str) -> Option<&'a AttributeProto> {
        self.node.attribute.iter().find(|attribute| attribute.name == name)
    }

    fn int(&self, name: &str, usual: i64) -> i64 {
        self.attribute(name).map_or(usual, |attribute| attribute.i)
    }

    fn float(&self, name: &str, usual: f32) -> f64 {
        f64::from(self.attribute(name).map_or(usual, |attribute| attribute.f))
    }

    fn ints(&self, name: &str) -> Option<&'a [i64]> {
        self.attribute(name).map(|attribute| attribute.ints.as_slice())
    }

    fn text(&self, name: &str, usual: &'static str) -> &'a str {
        let text = self.attribute(name).and_then(|attribute| str::from_utf8(&attribute.s).ok());
        text.unwrap_or(usual)
    }

    /// Whole numbers that are an attribute in old versions and an input in new ones.
    fn listed(&self, name: &str, input: usize) -> Result<Option<Vec<i64>>, Failure> {
        match self.ints(name) {
            Some(numbers) => Ok(Some(numbers.to_vec())),
            None => self.given(input).map(|tensor| tensor.wholes().map(<[_]>::to_vec)).transpose(),
        }
    }

    /// The outputs, by the family of the operator.
    fn evaluate(&self) -> Result<Vec<Tensor>, Failure> {
        let domain = self.node.domain.as_str();
        if !["", "ai.onnx", "ai.onnx.ml"].contains(&domain) {
            return Err(format!(
                "is of the domain {domain}, which the reference evaluator does not know"
            )
            .into());
        }
        let families = [
            elementwise::evaluate,
            moves::evaluate,
            gathers::evaluate,
            products::evaluate,
            reductions::evaluate,
            recurrent::evaluate,
            quantised::evaluate,
        ];
        for family in families {
            if let Some(found) = family(self)? {
                return Ok(found);
            }
        }
        Err("is none that the reference evaluator knows".into())
    }
}

/// What a family of operators makes of a node; nothing where it is of another family.
type Found = Result<Option<Vec<Tensor>>, Failure>;

fn one(tensor: Tensor) -> Found {
    Ok(Some(vec![tensor]))
}

/// The sizes before an axis, of it, and behind it, multiplied.
fn around(shape: &[usize], axis: usize) -> [usize; 3] {
    [count(&shape[..axis]), shape[axis], count(&shape[axis + 1..])]
}
