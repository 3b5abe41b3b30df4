//! Passes over many records, in lanes of some of them.

use std::ops::Range;

use sortie_nn::lanes::in_lanes;
use sortie_nn::layers::elementwise;
use sortie_nn::layers::matrix::Store;
use sortie_nn::tape::{Pass, Tape, Var};

use super::critic::Order;
use super::groups::Groups;

/// Records of a lane.
const RECORDS: usize = 128;

/// Lanes, and the memory of their passes.
#[derive(Debug, Default)]
pub(super) struct Lanes {
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
    found: Vec<Vec<f32>>,
}

impl Lanes {
    /// Computes matrices by groups, whose rows are those of all records.
    pub(super) fn compute(
        &mut self,
        threads: usize,
        (parameters, records): (&[f32], usize),
        groups: &Groups,
        found: &mut Vec<Vec<f32>>,
        pass: impl Fn(&mut Pass<'_>, Range<usize>, &Order) -> Vec<Var> + Sync,
    ) {
        self.run(threads, records, groups, |lane, range| {
            let mut pass_of = lane.tape.begin(parameters);
            let vars = pass(&mut pass_of, range, &lane.order);
            keep(&pass_of, &vars, &mut lane.found);
        });
        self.collect(found);
    }

    /// Adds the gradient of a loss that is the sum of what the lanes compute, and keeps matrices by groups besides.
    pub(super) fn descend(
        &mut self,
        threads: usize,
        (parameters, records): (&[f32], usize),
        groups: &Groups,
        (gradient, found): (&mut [f32], &mut Vec<Vec<f32>>),
        pass: impl Fn(&mut Pass<'_>, Range<usize>, &Order) -> (Var, Vec<Var>) + Sync,
    ) -> f64 {
        self.run(threads, records, groups, |lane, range| {
            let mut pass_of = lane.tape.begin(parameters);
            let (loss, vars) = pass(&mut pass_of, range, &lane.order);
            lane.loss = f64::from(pass_of.values(loss)[0]);
            keep(&pass_of, &vars, &mut lane.found);
            lane.gradient.clear();
            lane.gradient.resize(parameters.len(), 0.0);
            pass_of.backward(loss, &mut lane.gradient);
        });
        let lanes = &self.lanes[..records.div_ceil(RECORDS)];
        for lane in lanes {
            elementwise::scale(1.0, &lane.gradient, Store::Add, gradient);
        }
        self.collect(found);
        self.lanes.iter().map(|lane| lane.loss).sum()
    }

    fn run(
        &mut self,
        threads: usize,
        records: usize,
        groups: &Groups,
        work: impl Fn(&mut Lane, Range<usize>) + Sync,
    ) {
        let count = records.div_ceil(RECORDS);
        self.lanes.resize_with(count, Lane::default);
        in_lanes(threads, &mut self.lanes, |index, lane| {
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
    fn collect(&self, found: &mut Vec<Vec<f32>>) {
        let groups = self.lanes.first().map_or(0, |lane| lane.found.len());
        found.resize_with(groups, Vec::new);
        for (group, found) in found.iter_mut().enumerate() {
            found.clear();
            self.lanes.iter().for_each(|lane| found.extend_from_slice(&lane.found[group]));
        }
    }
}

fn keep(pass: &Pass<'_>, vars: &[Var], found: &mut Vec<Vec<f32>>) {
    found.resize_with(vars.len(), Vec::new);
    for (var, found) in vars.iter().zip(found) {
        found.clear();
        found.extend_from_slice(pass.values(*var));
    }
}
