//! Gradients over many rows, computed in chunks and added in their order.

use std::fmt;
use std::ops::Range;

use super::{Pass, Tape, Var};
use crate::lanes::in_lanes;
use crate::layers::elementwise;
use crate::layers::matrix::Store;

/// Most rows of a chunk, unless it is said otherwise: what fits beside weights into the caches of a core.
pub const ROWS: usize = 128;

/// A tape and a gradient for every chunk.
///
/// Chunks are what is computed at the same time; their number follows from the rows, not from the threads.
pub struct Chunks {
    chunks: Vec<Chunk>,
    rows: usize,
    tape: Box<dyn Fn() -> Tape + Send + Sync>,
}

#[derive(Debug, Default)]
struct Chunk {
    tape: Tape,
    gradient: Vec<f32>,
    loss: f64,
    found: Vec<Vec<f32>>,
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
        Self { chunks: Vec::new(), rows: ROWS, tape: Box::new(tape) }
    }

    /// Chunks of so many rows: more where the weights are many, which every chunk passes over.
    pub fn of_rows(rows: usize) -> Self {
        Self { rows, ..Self::default() }
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
        let alone = |pass: &mut Pass<'_>, range| (loss(pass, range), Vec::new());
        self.gradient_and_values(threads, parameters, rows, (gradient, &mut Vec::new()), alone)
    }

    /// The same, and keeps matrices that were computed besides.
    pub fn gradient_and_values(
        &mut self,
        threads: usize,
        parameters: &[f32],
        rows: usize,
        (gradient, found): (&mut [f32], &mut Vec<Vec<f32>>),
        loss: impl Fn(&mut Pass<'_>, Range<usize>) -> (Var, Vec<Var>) + Sync,
    ) -> f64 {
        self.run(threads, rows, |chunk, range| {
            let mut pass = chunk.tape.begin(parameters);
            let (loss, vars) = loss(&mut pass, range);
            chunk.loss = f64::from(pass.values(loss)[0]);
            keep(vars.iter().map(|var| pass.values(*var)), &mut chunk.found);
            back(&mut pass, loss, parameters, &mut chunk.gradient);
        });
        let chunks = &self.chunks[..rows.div_ceil(self.rows)];
        for chunk in chunks {
            elementwise::scale(1.0, &chunk.gradient, Store::Add, gradient);
        }
        join(chunks, found);
        chunks.iter().map(|chunk| chunk.loss).sum()
    }

    /// Computes matrices, each of which is then whole: what comes of all chunks behind each other.
    pub fn values(
        &mut self,
        threads: usize,
        parameters: &[f32],
        rows: usize,
        found: &mut Vec<Vec<f32>>,
        values: impl Fn(&mut Pass<'_>, Range<usize>) -> Vec<Var> + Sync,
    ) {
        self.run(threads, rows, |chunk, range| {
            let mut pass = chunk.tape.begin(parameters);
            let vars = values(&mut pass, range);
            keep(vars.iter().map(|var| pass.values(*var)), &mut chunk.found);
        });
        join(&self.chunks[..rows.div_ceil(self.rows)], found);
    }

    /// The slopes of a loss by leaves, which come behind it.
    pub fn slopes(
        &mut self,
        threads: usize,
        parameters: &[f32],
        rows: usize,
        found: &mut Vec<Vec<f32>>,
        loss: impl Fn(&mut Pass<'_>, Range<usize>) -> (Var, Vec<Var>) + Sync,
    ) {
        self.run(threads, rows, |chunk, range| {
            let mut pass = chunk.tape.begin(parameters);
            let (loss, leaves) = loss(&mut pass, range);
            back(&mut pass, loss, parameters, &mut chunk.gradient);
            let slopes = leaves.iter().map(|leaf| pass.slopes(*leaf).unwrap_or_default());
            keep(slopes, &mut chunk.found);
        });
        join(&self.chunks[..rows.div_ceil(self.rows)], found);
    }

    fn run(&mut self, threads: usize, rows: usize, work: impl Fn(&mut Chunk, Range<usize>) + Sync) {
        let (most, count) = (self.rows, rows.div_ceil(self.rows));
        while self.chunks.len() < count {
            self.chunks.push(Chunk { tape: (self.tape)(), ..Chunk::default() });
        }
        in_lanes(threads, &mut self.chunks[..count], |index, chunk| {
            work(chunk, index * most..rows.min((index + 1) * most));
        });
    }
}

fn back(pass: &mut Pass<'_>, loss: Var, parameters: &[f32], gradient: &mut Vec<f32>) {
    gradient.clear();
    gradient.resize(parameters.len(), 0.0);
    pass.backward(loss, gradient);
}

fn keep<'a>(all: impl ExactSizeIterator<Item = &'a [f32]>, found: &mut Vec<Vec<f32>>) {
    found.resize_with(all.len(), Vec::new);
    for (numbers, found) in all.zip(found) {
        found.clear();
        found.extend_from_slice(numbers);
    }
}

/// The numbers of every matrix in all chunks behind each other.
fn join(chunks: &[Chunk], found: &mut Vec<Vec<f32>>) {
    found.resize_with(chunks.first().map_or(0, |chunk| chunk.found.len()), Vec::new);
    for (matrix, found) in found.iter_mut().enumerate() {
        found.clear();
        chunks.iter().for_each(|chunk| found.extend_from_slice(&chunk.found[matrix]));
    }
}
