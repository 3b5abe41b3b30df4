//! Tensors that a program in another language reads.

use std::collections::HashMap;
use std::path::Path;

use safetensors::tensor::{Dtype, TensorView};

/// Tensors by name, each with its kind, shape and bytes.
#[derive(Default)]
pub(super) struct Tensors(Vec<(String, Dtype, Vec<usize>, Vec<u8>)>);

impl Tensors {
    pub(super) fn floats(&mut self, name: String, shape: &[usize], values: &[f32]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.0.push((name, Dtype::F32, shape.to_vec(), bytes));
    }

    pub(super) fn integers(&mut self, name: String, shape: &[usize], values: &[i64]) {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.0.push((name, Dtype::I64, shape.to_vec(), bytes));
    }

    pub(super) fn flags(&mut self, name: String, shape: &[usize], values: &[bool]) {
        let bytes = values.iter().map(|value| u8::from(*value)).collect();
        self.0.push((name, Dtype::BOOL, shape.to_vec(), bytes));
    }

    /// Writes all of them, and numbers as the file's metadata.
    pub(super) fn write(
        &self,
        settings: HashMap<String, String>,
        path: &Path,
    ) -> Result<(), safetensors::SafeTensorError> {
        let mut views = Vec::new();
        for (name, dtype, shape, bytes) in &self.0 {
            views.push((name, TensorView::new(*dtype, shape.clone(), bytes)?));
        }
        safetensors::serialize_to_file(views, Some(settings), path)
    }
}
