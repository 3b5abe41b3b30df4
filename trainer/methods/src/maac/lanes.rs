//! Passes over many records, in lanes of some of them.

use std::ops::Range;

use sortie_nn::lanes::in_lanes;
use sortie_nn::layers::elementwise;
use sortie_nn::layers::matrix::Store;
use sortie_nn::tape::{Pass, Tape, Var};

use super::critic::Order;
use super::groups::{Groups, Rows};

/// Records of a lane.
const RECORDS: usize = 128;

/// Lanes, and the memory of their passes.
#[derive(Debug)]
pub(super) struct Lanes {
    threads: usize,
    groups: Groups,
    lanes: Vec<Lane>,
}

#[derive(Debug, Default)]
struct Lane {
    tape: Tape,
    order: Order,
    /// Records that the order is of.
    ordered: usize,
    gradient: Vec<f32>,
    loss: f64,
    /// By groups.
    found: Rows,
}

impl Lanes {
    /// Lanes for records of these groups, on so many threads.
    pub(super) fn new(threads: usize, groups: &Groups) -> Self {
        Self { threads, groups: groups.clone(), lanes: Vec::new() }
    }

    /// Computes matrices by groups, whose rows are those of all records.
    pub(super) fn compute(
        &mut self,
        (parameters, records): (&[f32], usize),
        found: &mut Rows,
        pass: impl Fn(&mut Pass<'_>, Range<usize>, &Order) -> Vec<Var> + Sync,
    ) {
        self.run(records, |lane, range| {
            let mut pass_of = lane.tape.begin(parameters);
            let vars = pass(&mut pass_of, range, &lane.order);
            keep(vars.iter().map(|var| pass_of.values(*var)), &mut lane.found);
        });
        self.collect(found);
    }

    /// Adds the gradient of a loss that is the sum of what the lanes compute, and keeps matrices by groups besides.
    pub(super) fn descend(
        &mut self,
        (parameters, records): (&[f32], usize),
        (gradient, found): (&mut [f32], &mut Rows),
        pass: impl Fn(&mut Pass<'_>, Range<usize>, &Order) -> (Var, Vec<Var>) + Sync,
    ) -> f64 {
        self.run(records, |lane, range| {
            let mut pass_of = lane.tape.begin(parameters);
            let (loss, vars) = pass(&mut pass_of, range, &lane.order);
            lane.loss = f64::from(pass_of.values(loss)[0]);
            keep(vars.iter().map(|var| pass_of.values(*var)), &mut lane.found);
            back(&mut pass_of, loss, parameters, &mut lane.gradient);
        });
        for lane in &self.lanes {
            elementwise::scale(1.0, &lane.gradient, Store::Add, gradient);
        }
        self.collect(found);
        self.lanes.iter().map(|lane| lane.loss).sum()
    }

    /// Keeps the slopes of such a loss by leaves, which are matrices by groups.
    pub(super) fn slopes(
        &mut self,
        (parameters, records): (&[f32], usize),
        found: &mut Rows,
        pass: impl Fn(&mut Pass<'_>, Range<usize>, &Order) -> (Var, Vec<Var>) + Sync,
    ) {
        self.run(records, |lane, range| {
            let mut pass_of = lane.tape.begin(parameters);
            let (loss, leaves) = pass(&mut pass_of, range, &lane.order);
            back(&mut pass_of, loss, parameters, &mut lane.gradient);
            keep(
                leaves.iter().map(|leaf| pass_of.slopes(*leaf).unwrap_or_default()),
                &mut lane.found,
            );
        });
        self.collect(found);
    }

    fn run(&mut self, records: usize, work: impl Fn(&mut Lane, Range<usize>) + Sync) {
        let Self { threads, groups, lanes } = self;
        lanes.resize_with(records.div_ceil(RECORDS), Lane::default);
        in_lanes(*threads, lanes, |index, lane| {
            let range = index * RECORDS..records.min((index + 1) * RECORDS);
            if lane.ordered != range.len() {
                lane.ordered = range.len();
                groups.others(range.len(), &mut lane.order.others);
                groups.records(range.len(), &mut lane.order.records);
            }
            work(lane, range);
        });
    }

    /// The rows of a group in all lanes behind each other.
    fn collect(&self, found: &mut Rows) {
        let groups = self.lanes.first().map_or(0, |lane| lane.found.len());
        found.resize_with(groups, Vec::new);
        for (group, found) in found.iter_mut().enumerate() {
            found.clear();
            self.lanes.iter().for_each(|lane| found.extend_from_slice(&lane.found[group]));
        }
    }
}

fn back(pass: &mut Pass<'_>, loss: Var, parameters: &[f32], gradient: &mut Vec<f32>) {
    gradient.clear();
    gradient.resize(parameters.len(), 0.0);
    pass.backward(loss, gradient);
}

fn keep<'a>(all: impl ExactSizeIterator<Item = &'a [f32]>, found: &mut Rows) {
    found.resize_with(all.len(), Vec::new);
    for (numbers, found) in all.zip(found) {
        found.clear();
        found.extend_from_slice(numbers);
    }
}
