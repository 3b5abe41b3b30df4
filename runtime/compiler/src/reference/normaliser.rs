//! What a file does to its inputs before anything else: the means that it takes away, and the deviations by which it
//! divides. Inputs around these means are what its network was trained on.

use std::rc::Rc;

use tract_onnx::pb::NodeProto;

use super::tensor::{Failure, Numbers};
use super::{Call, Reference, Tensor};

/// Nodes that are followed behind one another.
const DEEPEST: usize = 16;

/// Mean and deviation of a number of an input.
pub(crate) type Spread = [f64; 2];

/// An input's numbers on their way: where each comes from, and what it was multiplied by and shifted by.
#[derive(Clone)]
struct Way {
    places: Tensor,
    scales: Vec<f64>,
    shifts: Vec<f64>,
}

impl Reference {
    /// Means and deviations of an input of some sizes; none where the file does not normalise it.
    pub(crate) fn normaliser(&self, input: &str, shape: &[usize]) -> Option<Vec<Spread>> {
        let count: usize = shape.iter().product();
        let places = Tensor::whole(shape.to_vec(), (0..count as i64).collect());
        let way = Way { places, scales: vec![1.0; count], shifts: vec![0.0; count] };
        let mut found = vec![None; count];
        self.follow(input, &way, 0, &mut found);
        if found.iter().all(Option::is_none) {
            return None;
        }
        Some(found.into_iter().map(|spread| spread.unwrap_or([0.0, 1.0])).collect())
    }

    /// Goes on with what takes a value, and notes what has become of it where there is nothing to follow.
    fn follow(&self, name: &str, way: &Way, depth: usize, found: &mut [Option<Spread>]) {
        let takes = |node: &&NodeProto| node.input.iter().any(|input| input == name);
        let mut is_end = true;
        for node in self.graph.node.iter().filter(takes) {
            let next = (depth < DEEPEST).then(|| self.behind(node, name, way)).flatten();
            if let (Some(next), Some(output)) = (next, node.output.first()) {
                self.follow(output, &next, depth + 1, found);
                is_end = false;
            }
        }
        if is_end {
            way.note(found);
        }
    }

    /// The way behind a node that moves, shifts or scales; none behind others.
    fn behind(&self, node: &NodeProto, name: &str, way: &Way) -> Option<Way> {
        match node.op_type.as_str() {
            "Identity" | "Cast" | "Clip" | "Dropout" => Some(way.clone()),
            "Slice" | "Reshape" | "Flatten" | "Squeeze" | "Unsqueeze" | "Transpose" => {
                way.moved(|places| self.moved(node, places)).ok()
            }
            "Add" | "Sub" | "Mul" | "Div" => {
                let [left, right] = node.input.as_slice() else { return None };
                let is_left = left == name;
                let other = self.stored.get(if is_left { right } else { left })?;
                way.changed(&node.op_type, other, is_left)
            }
            _ => None,
        }
    }

    /// What a node that moves numbers makes of their places.
    fn moved(&self, node: &NodeProto, places: &Tensor) -> Result<Tensor, Failure> {
        let stored = |name: &String| self.stored.get(name).cloned();
        let rest = node.input.iter().skip(1).map(stored);
        let inputs = std::iter::once(Some(Rc::new(places.clone()))).chain(rest).collect();
        let call = Call { node, version: self.version, inputs };
        call.evaluate()?.into_iter().next().ok_or_else(|| "has no output".into())
    }
}

impl Way {
    fn moved(&self, moved: impl Fn(&Tensor) -> Result<Tensor, Failure>) -> Result<Self, Failure> {
        let count = self.places.len() as i64;
        // Where in this way each number of the next one stands.
        let own = moved(&Tensor::whole(self.places.shape.clone(), (0..count).collect()))?;
        let shape = own.shape.clone();
        let own: Vec<usize> = own.wholes()?.iter().map(|at| *at as usize).collect();
        let of = |numbers: &[f64]| own.iter().filter_map(|at| numbers.get(*at).copied()).collect();
        let places = self.places.at(shape, &own);
        Ok(Self { places, scales: of(&self.scales), shifts: of(&self.shifts) })
    }

    /// Behind a sum or a product with numbers of the file; none where these are more than the input's.
    fn changed(&self, operator: &str, other: &Tensor, is_left: bool) -> Option<Self> {
        let other = other.spread(&self.places.shape).ok()?;
        let Numbers::Real(other) = &other.numbers else { return None };
        let mut way = self.clone();
        for ((scale, shift), other) in way.scales.iter_mut().zip(&mut way.shifts).zip(other) {
            [*scale, *shift] = match (operator, is_left) {
                ("Add", _) => [*scale, *shift + other],
                ("Sub", true) => [*scale, *shift - other],
                ("Sub", false) => [-*scale, other - *shift],
                ("Mul", _) => [*scale * other, *shift * other],
                ("Div", true) => [*scale / other, *shift / other],
                _ => return None,
            };
        }
        Some(way)
    }

    /// Notes the mean that becomes zero, and the deviation that becomes one.
    fn note(&self, found: &mut [Option<Spread>]) {
        let Ok(places) = self.places.wholes() else { return };
        for ((place, scale), shift) in places.iter().zip(&self.scales).zip(&self.shifts) {
            let spread = [-shift / scale, 1.0 / scale.abs()];
            let is_one = *scale == 1.0 && *shift == 0.0;
            let is_number = spread.iter().all(|number| number.abs() < 1.0e6) && spread[1] > 0.0;
            let to = found.get_mut(*place as usize).filter(|to| to.is_none());
            if let Some(to) = to.filter(|_| is_number && !is_one) {
                *to = Some(spread);
            }
        }
    }
}
