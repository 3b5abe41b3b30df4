//! Operators that only move numbers, to places that do not depend on what the numbers are.
//!
//! tract moves the places of the numbers in their stead: where each number of the result comes from is what it answers.

use std::iter::successors;

use sortie_core::internal::ops::Place;
use tract_onnx::prelude::*;
use tract_onnx::tract_hir::internal::*;

use super::arrange::strides;
use super::{Dimension, Lowered, Lowering};
use crate::graph::guarded;

/// The most copies that one node becomes.
const COPIES: usize = 64;

/// Where a number of the result comes from: its place among all numbers that go in, none where it is zero.
type Sources = Vec<Option<usize>>;

/// Numbers of a result that follow each other along an axis: from, and the sizes and steps along the source.
#[derive(Clone, Debug, PartialEq)]
struct Run {
    /// The first one's place in the result.
    at: usize,
    /// Its place in the source.
    from: usize,
    /// How many there are, and the step between them, slower dimension first.
    sizes: [usize; 2],
    steps: [usize; 2],
}

impl Lowering<'_> {
    /// Copies the numbers of some operands as the operator moves them; what else goes in is constant.
    pub(super) fn moved(&mut self, node: &TypedNode, operands: &[usize]) -> Lowered<()> {
        let mut values = Vec::new();
        for slot in operands {
            values.push(self.operand(node, *slot)?);
        }
        let sources = self.sources(node, operands)?;
        let shape = self.shape(node, 0)?;
        let to = self.arena.place(shape.iter().product());
        if sources.contains(&None) {
            let zero = self.stored(&[0.0]);
            let all = Dimension { size: to.len as usize, from: 0, to: 1 };
            self.arrange(node, zero, to, &[all])?;
        }
        let mut first = 0;
        let mut copies = Vec::new();
        for value in &values {
            let own = first..first + value.place.len as usize;
            let place = |source: &Option<usize>| {
                source.filter(|place| own.contains(place)).map(|place| place - first)
            };
            let own_sources: Sources = sources.iter().map(place).collect();
            let blocks = blocks(&own_sources, &shape);
            copies.extend(blocks.into_iter().map(|block| (value.place, block)));
            first = own.end;
        }
        if copies.len() > COPIES {
            let hint = "it moves numbers in more ways than 64 copies make";
            return Err(self.unsupported(node, hint));
        }
        for (from, (start, at, dimensions)) in copies {
            let behind = |place: Place, start: usize| Place {
                offset: place.offset + start as u32,
                len: place.len.saturating_sub(start as u32),
            };
            self.arrange(node, behind(from, start), behind(to, at), &dimensions)?;
        }
        self.give(node, 0, to)
    }

    /// Where every number of the result comes from.
    fn sources(&self, node: &TypedNode, operands: &[usize]) -> Lowered<Sources> {
        let mut inputs: TVec<TValue> = tvec!();
        let mut first = 1_u32;
        for slot in 0..node.inputs.len() {
            let outlet = self.outlet(node, slot)?;
            if !operands.contains(&slot) {
                let constant = self.constant(outlet);
                let hint = "where it takes numbers from is computed";
                let constant = constant.ok_or_else(|| self.unsupported(node, hint))?;
                inputs.push(constant.into_tvalue());
                continue;
            }
            let fact = self.model.outlet_fact(outlet).ok();
            let shape = fact.and_then(|fact| fact.shape.as_concrete().map(<[usize]>::to_vec));
            let shape = shape.ok_or_else(|| self.unsupported(node, "its size is left open"))?;
            let count = shape.iter().product::<usize>() as u32;
            let places: Vec<f32> = (first..first + count).map(|place| place as f32).collect();
            let places = Tensor::from_shape(&shape, &places);
            inputs.push(places.map_err(|_| self.unsupported(node, "it has no places"))?.into());
            first += count;
        }
        // Beyond this, places are no whole numbers of f32.
        if first >= 1 << 24 {
            return Err(self.unsupported(node, "it moves more than 2^24 numbers"));
        }
        let run = || {
            let moved = node.op.eval(&EvalContext::out_of_plan(), inputs)?;
            let moved = moved.into_iter().next().context("an output")?;
            let places = moved.to_plain_array_view::<f32>()?.iter().copied().collect::<Vec<_>>();
            Ok(places)
        };
        let places = guarded(run).map_err(|_| self.unsupported(node, "it moves no numbers"))?;
        let source = |place: &f32| (*place >= 1.0).then(|| *place as usize - 1);
        Ok(places.iter().map(source).collect())
    }
}

/// Copies that bring numbers where they belong: the first one's place in the source and in the result, and dimensions.
fn blocks(sources: &Sources, shape: &[usize]) -> Vec<(usize, usize, Vec<Dimension>)> {
    match along_axes(sources, shape) {
        Some((first, axes)) => {
            let own = strides(shape);
            let mut blocks = vec![(first, 0, Vec::new())];
            for (offsets, step) in axes.iter().zip(own) {
                let low = *offsets.iter().min().unwrap_or(&0);
                let places: Sources =
                    offsets.iter().map(|at| usize::try_from(at - low).ok()).collect();
                let runs = runs(&places);
                let with = |(from, at, dimensions): &(usize, usize, Vec<Dimension>), run: &Run| {
                    let mut dimensions = dimensions.clone();
                    dimensions.extend(run.dimensions(step));
                    let from = (*from + run.from).saturating_add_signed(low as isize);
                    (from, at + run.at * step, dimensions)
                };
                blocks = blocks
                    .iter()
                    .flat_map(|block| runs.iter().map(|run| with(block, run)).collect::<Vec<_>>())
                    .collect();
            }
            blocks
        }
        None => {
            let runs = runs(sources);
            runs.iter().map(|run| (run.from, run.at, run.dimensions(1))).collect()
        }
    }
}

/// Where the first number comes from and, where that is a sum of what every axis adds, those sums.
fn along_axes(sources: &Sources, shape: &[usize]) -> Option<(usize, Vec<Vec<i64>>)> {
    let places: Vec<i64> =
        sources.iter().map(|place| place.map(|place| place as i64)).collect::<Option<_>>()?;
    let first = *places.first()?;
    let own = strides(shape);
    let axes: Vec<Vec<i64>> = (shape.iter().zip(&own))
        .map(|(size, step)| (0..*size).map(|index| places[index * step] - first).collect())
        .collect();
    let sum = |mut index: usize| -> i64 {
        let parts = axes.iter().zip(&own).map(|(axis, step)| {
            let part = axis[index / step];
            index %= step;
            part
        });
        first + parts.sum::<i64>()
    };
    let is_sum = places.iter().enumerate().all(|(index, place)| sum(index) == *place);
    is_sum.then_some((first as usize, axes))
}

/// Numbers that follow each other in even steps, and as many of such rows as follow each other in even steps.
fn runs(sources: &Sources) -> Vec<Run> {
    let mut runs = Vec::new();
    let mut at = 0;
    while let Some(source) = sources.get(at) {
        let Some(from) = *source else {
            at += 1;
            continue;
        };
        let (count, step) = even(|index| sources.get(at + index).copied().flatten());
        let row = |start: usize| {
            let own = |index: usize| sources.get(start + index).copied().flatten();
            let first = own(0)?;
            (0..count).all(|index| own(index) == Some(first + index * step)).then_some(first)
        };
        let (rows, between) = even(|index| row(at + index * count));
        runs.push(Run { at, from, sizes: [rows, count], steps: [between, step] });
        at += rows * count;
    }
    runs
}

/// How many places follow each other in even steps forwards, and the step.
fn even(place: impl Fn(usize) -> Option<usize>) -> (usize, usize) {
    let step = |index: usize| place(index)?.checked_sub(place(index.checked_sub(1)?)?);
    let Some(first) = step(1) else { return (1, 0) };
    let follows = |index: &usize| (step(index + 1) == Some(first)).then_some(index + 1);
    (1 + successors(Some(1), follows).count(), first)
}

impl Run {
    /// The same as dimensions of a copy whose numbers lie so far apart in the result.
    fn dimensions(&self, apart: usize) -> Vec<Dimension> {
        let [rows, count] = self.sizes;
        let [between, step] = self.steps;
        let outer = Dimension { size: rows, from: between, to: count * apart };
        vec![outer, Dimension { size: count, from: step, to: apart }]
    }
}

/// The hint of the error that names such a node.
pub(super) fn nearest(operator: &str) -> &'static str {
    match operator {
        "Compress" => "it has no step, the nearest that has is Gather along one axis",
        "ScatterElements" | "ScatterNd" => {
            "plans put numbers at constant places, and add whole rows where computed places say"
        }
        "Scan" | "GruSeq" => {
            "a loop becomes steps where it is known how often it turns, at most 128 times"
        }
        "Sort" => "it has no step, the nearest that has is TopK of at most 16 numbers",
        "ConvTranspose" | "DeconvSum" | "Deconv" => "it has no step, the nearest that has is Conv",
        _ => "it has no step, docs/reference/operators.md lists what has",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(places: &[usize]) -> Sources {
        places.iter().copied().map(Some).collect()
    }

    #[test]
    fn numbers_in_even_steps_are_one_run() {
        assert_eq!(runs(&of(&[2, 3, 4])).len(), 1);
        assert_eq!(runs(&of(&[0, 0, 1, 1, 2, 2])).len(), 1);
        assert_eq!(runs(&of(&[0, 1, 2, 0, 1, 2])).len(), 1);
        assert_eq!(runs(&of(&[2, 1, 0])).len(), 3);
        let with_zero = vec![None, Some(4), Some(6), None];
        let run = Run { at: 1, from: 4, sizes: [1, 2], steps: [0, 2] };
        assert_eq!(runs(&with_zero), [run]);
    }

    #[test]
    fn blocks_give_every_number_its_source() {
        let mirrored = |size: usize| [1].into_iter().chain(0..size).chain([size - 2]);
        let mirror: Vec<usize> =
            mirrored(3).flat_map(|row| mirrored(4).map(move |column| row * 4 + column)).collect();
        for (sources, shape, most) in [
            (of(&mirror), vec![5, 6], 9),
            (of(&[3, 1, 2, 5]), vec![4], 4),
            (vec![Some(0), None, Some(3), Some(4)], vec![2, 2], 2),
        ] {
            let blocks = blocks(&sources, &shape);
            assert!(blocks.len() <= most, "{blocks:?}");
            let mut found = vec![None; sources.len()];
            for (from, at, dimensions) in blocks {
                let mut places = vec![(from, at)];
                for Dimension { size, from, to } in dimensions {
                    let along =
                        |(a, b): (usize, usize)| (0..size).map(move |i| (a + i * from, b + i * to));
                    places = places.into_iter().flat_map(along).collect();
                }
                places.into_iter().for_each(|(from, at)| found[at] = Some(from));
            }
            assert_eq!(found, sources);
        }
    }
}
