//! Gradients over many rows, computed in chunks and added in their order.

use std::fmt;
use std::ops::Range;

use super::{Pass, Tape, Var};
use crate::lanes::in_lanes;
use crate::layers::elementwise;
use crate::layers::matrix::Store;

/// Most rows of a chunk: what fits beside weights into the caches of a core.
pub const ROWS: usize = 128;

/// A tape and a gradient for every chunk.
///
/// Chunks are what is computed at the same time; their number follows from the rows, not from the threads.
pub struct Chunks {
    chunks: Vec<Chunk>,
    tape: Box<dyn Fn() -> Tape + Send + Sync>,
}

#[derive(Debug, Default)]
struct Chunk {
    tape: Tape,
    gradient: Vec<f32>,
    loss: f64,
}

impl fmt::Debug for Chunks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Chunks").field("chunks", &self.chunks).finish_non_exhaustive()
    }
}

impl Default for Chunks {
    fn default() -> Self {
        Self::new(Tape::default)
    }
}

impl Chunks {
    /// Chunks whose tapes are made so, with the custom passes that they need.
    pub fn new(tape: impl Fn() -> Tape + Send + Sync + 'static) -> Self {
        Self { chunks: Vec::new(), tape: Box::new(tape) }
    }

    /// Adds to `gradient` that of a loss over so many rows, and returns the loss.
    ///
    /// `loss` computes the part of some of the rows as a matrix of one number; the whole is the sum of parts.
    pub fn gradient(
        &mut self,
        threads: usize,
        parameters: &[f32],
        rows: usize,
        gradient: &mut [f32],
        loss: impl Fn(&mut Pass<'_>, Range<usize>) -> Var + Sync,
    ) -> f64 {
        let count = rows.div_ceil(ROWS);
        while self.chunks.len() < count {
            self.chunks.push(Chunk { tape: (self.tape)(), ..Chunk::default() });
        }
        let chunks = &mut self.chunks[..count];
        in_lanes(threads, chunks, |index, Chunk { tape, gradient, loss: part }| {
            gradient.clear();
            gradient.resize(parameters.len(), 0.0);
            let mut pass = tape.begin(parameters);
            let value = loss(&mut pass, index * ROWS..rows.min((index + 1) * ROWS));
            *part = f64::from(pass.values(value)[0]);
            pass.backward(value, gradient);
        });
        for chunk in &*chunks {
            elementwise::scale(1.0, &chunk.gradient, Store::Add, gradient);
        }
        chunks.iter().map(|chunk| chunk.loss).sum()
    }
}
