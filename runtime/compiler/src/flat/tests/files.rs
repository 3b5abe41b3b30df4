//! Small ONNX files.

use prost::Message;
use sortie_plans::{CompileError, PolicyFacts, PolicyOptions};
use tract_onnx::pb;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::tensor_shape_proto::{Dimension, dimension};
use tract_onnx::pb::type_proto;

use crate::flat::FlatGraph;

/// A file under construction.
#[derive(Default)]
pub(super) struct File(pub(super) pb::GraphProto);

impl File {
    /// An input; sizes that are no numbers are names, `?` none.
    pub(super) fn input(mut self, name: &str, kind: DataType, sizes: &[&str]) -> Self {
        self.0.input.push(value(name, kind, sizes));
        self
    }

    /// An output of floats whose sizes nobody noted.
    pub(super) fn output(mut self, name: &str) -> Self {
        self.0.output.push(value(name, DataType::Float, &[]));
        self
    }

    /// An output of whole numbers.
    pub(super) fn choice(mut self, name: &str) -> Self {
        self.0.output.push(value(name, DataType::Int64, &[]));
        self
    }

    pub(super) fn node(self, operator: &str, inputs: &[&str], output: &str) -> Self {
        self.node_with(operator, inputs, output, Vec::new())
    }

    /// A layer of so many inputs and outputs, all weights a quarter.
    pub(super) fn layer(self, input: &str, [inputs, outputs]: [usize; 2], output: &str) -> Self {
        let weights = format!("{output}.weight");
        let tensor = pb::TensorProto {
            name: weights.clone(),
            data_type: DataType::Float as i32,
            dims: vec![inputs as i64, outputs as i64],
            float_data: vec![0.25; inputs * outputs],
            ..Default::default()
        };
        let mut file = self.node("MatMul", &[input, &weights], output);
        file.0.initializer.push(tensor);
        file
    }

    /// The place of the largest of the last axis.
    pub(super) fn argmax(self, scores: &str, output: &str) -> Self {
        let number = |name: &str, i| pb::AttributeProto {
            name: name.into(),
            i,
            r#type: 2,
            ..Default::default()
        };
        self.node_with("ArgMax", &[scores], output, vec![number("axis", -1), number("keepdims", 0)])
    }

    /// Constant numbers.
    pub(super) fn constant(mut self, name: &str, sizes: &[usize], numbers: &[f32]) -> Self {
        self.0.initializer.push(pb::TensorProto {
            name: name.to_owned(),
            data_type: DataType::Float as i32,
            dims: sizes.iter().map(|size| *size as i64).collect(),
            float_data: numbers.to_vec(),
            ..Default::default()
        });
        self
    }

    /// Constant whole numbers.
    pub(super) fn whole(mut self, name: &str, numbers: &[i64]) -> Self {
        self.0.initializer.push(pb::TensorProto {
            name: name.to_owned(),
            data_type: DataType::Int64 as i32,
            dims: vec![numbers.len() as i64],
            int64_data: numbers.to_vec(),
            ..Default::default()
        });
        self
    }

    pub(super) fn node_with(
        self,
        operator: &str,
        inputs: &[&str],
        output: &str,
        attribute: Vec<pb::AttributeProto>,
    ) -> Self {
        self.nodes(operator, inputs, &[output], attribute)
    }

    /// A node of several outputs, named after the first.
    pub(super) fn nodes(
        mut self,
        operator: &str,
        inputs: &[&str],
        outputs: &[&str],
        attribute: Vec<pb::AttributeProto>,
    ) -> Self {
        self.0.node.push(pb::NodeProto {
            name: format!("{}.node", outputs.first().copied().unwrap_or_default()),
            op_type: operator.to_owned(),
            input: inputs.iter().map(ToString::to_string).collect(),
            output: outputs.iter().map(ToString::to_string).collect(),
            attribute,
            ..Default::default()
        });
        self
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let set = pb::OperatorSetIdProto { domain: String::new(), version: 17 };
        let file = pb::ModelProto {
            ir_version: 8,
            opset_import: vec![set],
            graph: Some(self.0.clone()),
            ..Default::default()
        };
        file.encode_to_vec()
    }

    pub(super) fn read(&self, options: &PolicyOptions) -> Result<PolicyFacts, CompileError> {
        FlatGraph::read(&self.bytes(), options).map(|graph| graph.interface.facts)
    }

    /// Reads it as it is.
    pub(super) fn found(&self) -> PolicyFacts {
        self.read(&PolicyOptions::default()).unwrap()
    }

    /// Why it cannot be read as it is.
    pub(super) fn refused(&self) -> String {
        self.read(&PolicyOptions::default()).unwrap_err().to_string()
    }
}

fn value(name: &str, kind: DataType, sizes: &[&str]) -> pb::ValueInfoProto {
    let size = |size: &&str| Dimension {
        value: match size.parse() {
            Ok(size) => Some(dimension::Value::DimValue(size)),
            Err(_) if *size == "?" => None,
            Err(_) => Some(dimension::Value::DimParam(size.to_string())),
        },
        ..Default::default()
    };
    let shape = pb::TensorShapeProto { dim: sizes.iter().map(size).collect() };
    let tensor = type_proto::Tensor { elem_type: kind as i32, shape: Some(shape) };
    let value = Some(type_proto::Value::TensorType(tensor));
    pb::ValueInfoProto {
        name: name.to_owned(),
        r#type: Some(pb::TypeProto { value, ..Default::default() }),
        ..Default::default()
    }
}
