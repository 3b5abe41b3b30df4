//! Reads the recorded tensors of `tests/golden`.

use std::collections::HashMap;
use std::path::PathBuf;

use safetensors::SafeTensors;
use serde_json::Value;

/// A recorded tensor: its sizes and its numbers.
#[derive(Clone, Debug)]
pub(crate) struct Tensor {
    /// Sizes.
    pub(crate) shape: Vec<usize>,
    /// Numbers, row-major.
    pub(crate) data: Vec<f64>,
}

impl Tensor {
    pub(crate) fn f32s(&self) -> Vec<f32> {
        self.data.iter().map(|v| *v as f32).collect()
    }
}

pub(crate) type Tensors = HashMap<String, Tensor>;

/// One recorded case: tensors by name, under `w/`, `in/` and `out/`.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) tensors: Tensors,
}

impl Case {
    pub(crate) fn get(&self, name: &str) -> &Tensor {
        self.tensors.get(name).unwrap_or_else(|| panic!("{}: no tensor `{name}`", self.name))
    }
}

fn folder(part: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden").join(part)
}

/// A recorded file as it is.
pub(crate) fn json_file(group: &str) -> Value {
    let path = folder("networks").join(format!("{group}.json"));
    let text = std::fs::read_to_string(path).expect("golden file");
    serde_json::from_str(&text).expect("golden JSON")
}

/// The cases of a recorded file.
pub(crate) fn json_cases(group: &str) -> Vec<Case> {
    let cases = json_file(group);
    let cases = cases["cases"].as_array().expect("a list of cases");
    cases.iter().map(json_case).collect()
}

fn json_case(case: &Value) -> Case {
    let mut tensors = Tensors::new();
    for (part, prefix) in [("weights", "w"), ("inputs", "in"), ("outputs", "out")] {
        // Masks have no weights.
        for (name, tensor) in case[part].as_object().into_iter().flatten() {
            tensors.insert(format!("{prefix}/{name}"), json_tensor(tensor));
        }
    }
    Case { name: case["id"].to_string(), tensors }
}

/// Reads a tensor of a JSON file; infinities are strings there.
pub(crate) fn json_tensor(tensor: &Value) -> Tensor {
    let shape = tensor["shape"].as_array().expect("sizes");
    let data = tensor["data"].as_array().expect("numbers");
    let number = |value: &Value| match value.as_str() {
        Some("-inf") => f64::NEG_INFINITY,
        _ => value.as_f64().expect("a number"),
    };
    Tensor {
        shape: shape.iter().map(|v| v.as_u64().expect("a size") as usize).collect(),
        data: data.iter().map(number).collect(),
    }
}

/// The case of a recorded file of tensors.
pub(crate) fn safetensors_case(part: &str, group: &str) -> Case {
    let bytes =
        std::fs::read(folder(part).join(format!("{group}.safetensors"))).expect("golden file");
    let file = SafeTensors::deserialize(&bytes).expect("golden tensors");
    let mut tensors = Tensors::new();
    for (name, view) in file.tensors() {
        let data = match view.dtype() {
            safetensors::Dtype::F32 => {
                view.data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b).into()).collect()
            }
            safetensors::Dtype::F64 => {
                view.data().as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
            }
            safetensors::Dtype::I32 => {
                view.data().as_chunks().0.iter().map(|b| i32::from_le_bytes(*b).into()).collect()
            }
            safetensors::Dtype::I64 => {
                view.data().as_chunks().0.iter().map(|b| i64::from_le_bytes(*b) as f64).collect()
            }
            safetensors::Dtype::U8 => view.data().iter().map(|b| f64::from(*b)).collect(),
            other => panic!("unexpected type {other:?}"),
        };
        tensors.insert(name, Tensor { shape: view.shape().to_vec(), data });
    }
    Case { name: group.to_owned(), tensors }
}
