//! Quantised files: whole numbers on a scale, and their products, as the floats that they stand for.

use std::collections::HashMap;

use tract_onnx::pb::tensor_proto::DataType::{Float, Int8, Int64, Uint8};
use tract_onnx::pb::{AttributeProto, GraphProto, NodeProto, TensorProto};

/// Puts floats, rounded where the file rounds, in place of whole numbers on a scale. Sums of their products are exact
/// as far as 2^24.
pub(super) fn as_floats(graph: &mut GraphProto) {
    let constants = Constants::of(graph);
    for node in std::mem::take(&mut graph.node) {
        let mut floats =
            Floats { constants: &constants, node: &node, nodes: vec![], added: vec![] };
        match floats.write() {
            Some(()) => {
                graph.node.append(&mut floats.nodes);
                graph.initializer.append(&mut floats.added);
            }
            None => graph.node.push(node),
        }
    }
}

/// Types and sizes of the numbers that stand in the file.
struct Constants(HashMap<String, (i32, Vec<i64>)>);

impl Constants {
    fn of(graph: &GraphProto) -> Self {
        let facts = |tensor: &TensorProto| (tensor.data_type, tensor.dims.clone());
        let stored = graph.initializer.iter().map(|tensor| (tensor.name.clone(), facts(tensor)));
        let written = graph.node.iter().filter(|node| node.op_type == "Constant");
        let written = written.filter_map(|node| {
            Some((node.output.first()?.clone(), facts(node.attribute.first()?.t.as_ref()?)))
        });
        Self(stored.chain(written).collect())
    }

    /// The least and the largest number of a type that this constant has; of none, of bytes.
    fn limits(&self, zero: Option<&str>) -> Option<[f32; 2]> {
        let kind = zero.map_or(Some(Uint8 as i32), |zero| Some(self.0.get(zero)?.0))?;
        match kind {
            kind if kind == Uint8 as i32 => Some([0.0, 255.0]),
            kind if kind == Int8 as i32 => Some([-128.0, 127.0]),
            _ => None,
        }
    }
}

/// What is written in the place of one node.
struct Floats<'a> {
    constants: &'a Constants,
    node: &'a NodeProto,
    nodes: Vec<NodeProto>,
    added: Vec<TensorProto>,
}

impl Floats<'_> {
    /// Writes what computes the node's outputs; none where it is not about whole numbers on a scale, or on many in a way
    /// that has no floats here.
    fn write(&mut self) -> Option<()> {
        let node = self.node;
        let at = |place: usize| node.input.get(place).filter(|name| !name.is_empty());
        let given = |place: usize| at(place).map(String::as_str);
        let is_in_blocks = node.attribute.iter().any(|attribute| attribute.name == "block_size");
        let result = match node.op_type.as_str() {
            _ if is_in_blocks => return None,
            "QuantizeLinear" => self.rounded(given(0)?, given(1)?, given(2))?,
            "DequantizeLinear" => self.scaled(given(0)?, given(1)?, given(2))?,
            "DynamicQuantizeLinear" => return self.rounded_anew(given(0)?),
            "MatMulInteger" | "ConvInteger" => {
                let factors = [self.apart(given(0)?, given(2)), self.apart(given(1)?, given(3))];
                self.product(&factors)
            }
            "QLinearMatMul" => {
                let left = self.scaled(given(0)?, given(1)?, given(2))?;
                let right = self.scaled(given(3)?, given(4)?, given(5))?;
                let sums = self.product(&[left, right]);
                self.rounded(&sums, given(6)?, given(7))?
            }
            _ => return None,
        };
        self.give(0, &result)
    }

    /// `round(x / scale) + zero`, within the type of `zero`.
    fn rounded(&mut self, x: &str, scale: &str, zero: Option<&str>) -> Option<String> {
        let limits = self.constants.limits(zero)?;
        let [scale, zero] = self.along(x, scale, zero)?;
        let steps = self.add("Div", &[x, &scale?]);
        let mut whole = self.add("Round", &[&steps]);
        if let Some(zero) = zero {
            whole = self.add("Add", &[&whole, &zero]);
        }
        Some(self.within(&whole, limits))
    }

    /// `(x - zero) scale`
    fn scaled(&mut self, x: &str, scale: &str, zero: Option<&str>) -> Option<String> {
        let [scale, zero] = self.along(x, scale, zero)?;
        let mut x = self.float(x);
        if let Some(zero) = zero {
            x = self.add("Sub", &[&x, &zero]);
        }
        Some(self.add("Mul", &[&x, &scale?]))
    }

    /// Numbers on the scale of 256 steps that all of them and zero fit, the scale, and where zero stands on it.
    fn rounded_anew(&mut self, x: &str) -> Option<()> {
        let [nothing, one, last] = [0.0, 1.0, 255.0].map(|number| self.number(number));
        let keepdims = || vec![whole("keepdims", 0)];
        let largest = self.add_with("ReduceMax", &[x], keepdims());
        let largest = self.add("Max", &[&largest, &nothing]);
        let smallest = self.add_with("ReduceMin", &[x], keepdims());
        let smallest = self.add("Min", &[&smallest, &nothing]);
        let range = self.add("Sub", &[&largest, &smallest]);
        let scale = self.add("Div", &[&range, &last]);
        // Where all are zero, any scale fits.
        let is_flat = self.add("Equal", &[&range, &nothing]);
        let scale = self.add("Where", &[&is_flat, &one, &scale]);
        let below = self.add("Div", &[&smallest, &scale]);
        let zero = self.add("Neg", &[&below]);
        let zero = self.within(&zero, [0.0, 255.0]);
        let zero = self.add("Round", &[&zero]);
        let steps = self.add("Div", &[x, &scale]);
        let steps = self.add("Round", &[&steps]);
        let steps = self.add("Add", &[&steps, &zero]);
        let steps = self.within(&steps, [0.0, 255.0]);
        [steps, scale, zero].iter().enumerate().try_for_each(|(slot, from)| self.give(slot, from))
    }

    /// A scale and a zero as floats that stand along the axis of `x` that they are for.
    fn along(&mut self, x: &str, scale: &str, zero: Option<&str>) -> Option<[Option<String>; 2]> {
        let scales = self.constants.0.get(scale).map_or(1, |(_, sizes)| sizes.iter().product());
        let mut both = [Some(scale), zero].map(|name| name.map(|name| self.float(name)));
        if scales > 1 {
            let axes = self.constants.0.get(x)?.1.len() as i64;
            let axis = self.node.attribute.iter().find(|attribute| attribute.name == "axis");
            let axis = axis.map_or(1, |axis| axis.i).rem_euclid(axes.max(1));
            let sizes = std::iter::once(scales).chain((axis + 1..axes).map(|_| 1)).collect();
            let sizes = self.tensor(TensorProto {
                data_type: Int64 as i32,
                dims: vec![axes - axis],
                int64_data: sizes,
                ..TensorProto::default()
            });
            both = both.map(|name| name.map(|name| self.add("Reshape", &[&name, &sizes])));
        }
        Some(both)
    }

    fn apart(&mut self, x: &str, zero: Option<&str>) -> String {
        let x = self.float(x);
        let Some(zero) = zero else { return x };
        let zero = self.float(zero);
        self.add("Sub", &[&x, &zero])
    }

    fn product(&mut self, factors: &[String; 2]) -> String {
        let is_convolution = self.node.op_type == "ConvInteger";
        let operator = if is_convolution { "Conv" } else { "MatMul" };
        let attributes = self.node.attribute.clone();
        self.add_with(operator, &[&factors[0], &factors[1]], attributes)
    }

    fn within(&mut self, x: &str, limits: [f32; 2]) -> String {
        let [least, most] = limits.map(|limit| self.number(limit));
        let x = self.add("Max", &[x, &least]);
        self.add("Min", &[&x, &most])
    }

    fn float(&mut self, x: &str) -> String {
        self.add_with("Cast", &[x], vec![whole("to", Float as i64)])
    }

    fn number(&mut self, number: f32) -> String {
        let float_data = vec![number];
        self.tensor(TensorProto { data_type: Float as i32, float_data, ..TensorProto::default() })
    }

    fn tensor(&mut self, tensor: TensorProto) -> String {
        let name = self.name("constant", self.added.len());
        self.added.push(TensorProto { name: name.clone(), ..tensor });
        name
    }

    fn add(&mut self, operator: &str, inputs: &[&str]) -> String {
        self.add_with(operator, inputs, Vec::new())
    }

    fn add_with(
        &mut self,
        operator: &str,
        inputs: &[&str],
        attribute: Vec<AttributeProto>,
    ) -> String {
        let name = self.name("step", self.nodes.len());
        self.nodes.push(NodeProto {
            op_type: operator.to_owned(),
            name: name.clone(),
            input: inputs.iter().map(|name| (*name).to_owned()).collect(),
            output: vec![name.clone()],
            attribute,
            ..NodeProto::default()
        });
        name
    }

    /// A name that no other value has.
    fn name(&self, kind: &str, number: usize) -> String {
        format!("{}.quantised.{kind}.{number}", self.node.output.first().map_or("", String::as_str))
    }

    /// Makes a value one of the node's outputs.
    fn give(&mut self, slot: usize, from: &str) -> Option<()> {
        if let Some(output) = self.node.output.get(slot).filter(|name| !name.is_empty()) {
            self.add("Identity", &[from]);
            self.nodes.last_mut()?.output = vec![output.clone()];
        }
        Some(())
    }
}

fn whole(name: &str, i: i64) -> AttributeProto {
    AttributeProto { name: name.into(), r#type: 2, i, ..AttributeProto::default() }
}
