//! Choices of actions from scores, row by row.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use sortie_core::DecideError;
use sortie_core::choose::masked_argmax;
use sortie_plans::{OutputRole, PolicyOutput};

use crate::interface::{Fit, shape_as};

/// The sizes of a mask of one case.
pub(crate) fn mask_shape(output: &PolicyOutput) -> PyResult<Vec<usize>> {
    let OutputRole::Discrete(actions) = output.role else {
        let message =
            format!("`{}` is no choice of actions: `available` is of no use", output.name);
        return Err(PyTypeError::new_err(message));
    };
    let mut shape = choices_shape(output, Fit::WithoutBatch).to_vec();
    shape.push(actions);
    Ok(shape)
}

/// The sizes of the choices that an output is: one for each row of scores.
pub(crate) fn choices_shape(output: &PolicyOutput, fit: Fit) -> &[usize] {
    let shape = match output.shape.split_last() {
        // Scores; of an `ArgMax` inside, the file has one place for each row.
        Some((_, rows)) if !output.kind.is_integer() => rows,
        _ => &output.shape,
    };
    let shape = shape_as(shape, fit);
    // One choice is a number.
    if shape.iter().product::<usize>() == 1 { &[] } else { shape }
}

/// The choice of every row of scores. An empty mask leaves everything available.
pub(crate) fn choices(
    scores: &[f32],
    actions: usize,
    mask: &[u16],
) -> Result<Vec<i64>, DecideError> {
    let everything = vec![1; if mask.is_empty() { actions } else { 0 }];
    let mut masks = mask.chunks(actions.max(1));
    let choice = |scores: &[f32]| {
        let mask = masks.next().unwrap_or(&everything);
        masked_argmax(scores, mask).map(|decision| decision.action.into())
    };
    scores.chunks(actions.max(1)).map(choice).collect()
}
