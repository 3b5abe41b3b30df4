//! ONNX models as protocol buffers: a graph grows node by node.

use crate::protobuf::Message;

const IR_VERSION: i64 = 8;
const OPSET: i64 = 17;

/// Element types that the graphs use.
#[derive(Clone, Copy, Debug)]
pub enum Element {
    /// 32-bit floats.
    Float,
    /// 64-bit integers.
    Int64,
    /// Truth.
    Bool,
}

impl Element {
    /// Its number in files.
    pub fn id(self) -> i64 {
        match self {
            Self::Float => 1,
            Self::Int64 => 7,
            Self::Bool => 9,
        }
    }
}

/// One dimension of an input or output.
#[derive(Clone, Copy, Debug)]
pub enum Dim<'a> {
    /// Of this size.
    Fixed(usize),
    /// Of any size, by a name.
    Symbol(&'a str),
}

/// An attribute of a node.
#[derive(Clone, Copy, Debug)]
pub enum Attribute<'a> {
    /// A whole number.
    Int(&'a str, i64),
    /// A number.
    Float(&'a str, f32),
    /// Whole numbers.
    Ints(&'a str, &'a [i64]),
}

/// A graph under construction.
#[derive(Clone, Debug, Default)]
pub struct Graph {
    nodes: Vec<Message>,
    initializers: Vec<Message>,
    inputs: Vec<Message>,
    outputs: Vec<Message>,
}

impl Graph {
    /// Declares an input and returns its name.
    pub fn input<'n>(
        &mut self,
        name: &'n str,
        element: Element,
        shape: &[Dim<'_>],
        doc: &str,
    ) -> &'n str {
        self.inputs.push(value(name, element, shape, doc));
        name
    }

    /// Declares an output, which a node of that name computes.
    pub fn output(&mut self, name: &str, element: Element, shape: &[Dim<'_>], doc: &str) {
        self.outputs.push(value(name, element, shape, doc));
    }

    /// Adds a constant of f32 and returns its name.
    pub fn floats<'n>(&mut self, name: &'n str, shape: &[usize], values: &[f32]) -> &'n str {
        let raw = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.initializer(name, Element::Float, shape, raw)
    }

    /// Adds a constant of integers and returns its name.
    pub fn integers<'n>(&mut self, name: &'n str, values: &[i64]) -> &'n str {
        let raw = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.initializer(name, Element::Int64, &[values.len()], raw)
    }

    fn initializer<'n>(
        &mut self,
        name: &'n str,
        element: Element,
        shape: &[usize],
        raw: Vec<u8>,
    ) -> &'n str {
        let dims: Vec<i64> = shape.iter().map(|&dim| dim as i64).collect();
        let tensor = Message::default().integers(1, &dims).integer(2, element.id());
        self.initializers.push(tensor.text(8, name).bytes(9, &raw));
        name
    }

    /// Adds a node whose output carries its name, and returns that name.
    pub fn node(
        &mut self,
        name: &str,
        operator: &str,
        inputs: &[&str],
        attributes: &[Attribute<'_>],
    ) -> String {
        let node = inputs.iter().fold(Message::default(), |node, input| node.text(1, input));
        let node = node.text(2, name).text(3, name).text(4, operator);
        let attributes: Vec<Message> = attributes.iter().map(attribute).collect();
        self.nodes.push(node.messages(5, &attributes));
        name.to_owned()
    }

    /// The finished model.
    pub fn into_model(self, name: &str, doc: &str, metadata: &[(&str, String)]) -> Vec<u8> {
        let graph = Message::default()
            .messages(1, &self.nodes)
            .text(2, name)
            .messages(5, &self.initializers)
            .text(10, doc)
            .messages(11, &self.inputs)
            .messages(12, &self.outputs);
        let opset = Message::default().text(1, "").integer(2, OPSET);
        let entry = |(key, value): &(&str, String)| Message::default().text(1, key).text(2, value);
        let metadata: Vec<Message> = metadata.iter().map(entry).collect();
        // The graph comes last, so that a file that was cut off has no whole graph.
        Message::default()
            .integer(1, IR_VERSION)
            .text(2, "sortie")
            .text(3, env!("CARGO_PKG_VERSION"))
            .text(6, doc)
            .message(8, &opset)
            .messages(14, &metadata)
            .message(7, &graph)
            .into_bytes()
    }
}

/// What every graph says of itself: what it is, and the contract that it is for; then its sizes.
pub fn metadata<const SIZES: usize>(
    graph: &str,
    contract: u64,
    sizes: [(&'static str, usize); SIZES],
) -> Vec<(&'static str, String)> {
    let common = [
        ("sortie.graph", graph.to_owned()),
        ("sortie.format", "1".to_owned()),
        ("sortie.contract", format!("{contract:016x}")),
    ];
    let sizes = sizes.map(|(name, size)| (name, size.to_string()));
    common.into_iter().chain(sizes).collect()
}

fn value(name: &str, element: Element, shape: &[Dim<'_>], doc: &str) -> Message {
    let dim = |dim: &Dim<'_>| match *dim {
        Dim::Fixed(size) => Message::default().integer(1, size as i64),
        Dim::Symbol(symbol) => Message::default().text(2, symbol),
    };
    let dims: Vec<Message> = shape.iter().map(dim).collect();
    let shape = Message::default().messages(1, &dims);
    let tensor = Message::default().integer(1, element.id()).message(2, &shape);
    let kind = Message::default().message(1, &tensor);
    Message::default().text(1, name).message(2, &kind).text(3, doc)
}

fn attribute(attribute: &Attribute<'_>) -> Message {
    match *attribute {
        Attribute::Int(name, value) => {
            Message::default().text(1, name).integer(3, value).integer(20, 2)
        }
        Attribute::Float(name, value) => {
            Message::default().text(1, name).float(2, value).integer(20, 1)
        }
        Attribute::Ints(name, values) => {
            Message::default().text(1, name).integers(8, values).integer(20, 7)
        }
    }
}
