//! Random programs compute the same before and after: every float holds the name of what was computed there.

use std::collections::HashMap;

use sortie_core::internal::ops::{
    Arrange, Combination, Combine, Function, Input, Map, MaskedArgmax, Meaning, Op, Output,
    OutputRows, Place, Select, State,
};

use super::{ALIGN, tidy};
use crate::lower::agent::Arena;
use crate::lower::tests::networks::Random;

/// What a float holds: the number of an expression, the same for the same one.
#[derive(Default)]
struct Names(HashMap<Vec<usize>, usize>);

impl Names {
    fn of(&mut self, expression: Vec<usize>) -> usize {
        let next = self.0.len() + 1;
        *self.0.entry(expression).or_insert(next)
    }
}

/// The outputs, the scores that are chosen from, and the next states, of a program whose states are given first.
fn computed(ops: &[Op], floats: usize, names: &mut Names) -> Vec<Vec<usize>> {
    let mut memory = vec![0; floats];
    let mut states = 0;
    for op in ops {
        let Op::State(State { from, .. }) = op else { continue };
        states += 1;
        (0..from.len as usize)
            .for_each(|i| memory[from.offset as usize + i] = names.of(vec![1, states, i]));
    }
    let mut results = Vec::new();
    for op in ops {
        let at = |place: &Place, i: usize| memory[place.offset as usize + i];
        let (to, values): (Place, Vec<usize>) = match op {
            Op::Input(Input { index, to, .. }) => {
                let name = |i| names.of(vec![2, *index as usize, i]);
                (*to, (0..to.len as usize).map(name).collect())
            }
            Op::Map(Map { a, from, to, .. }) => {
                let name = |i| names.of(vec![3, *a as usize, at(from, i)]);
                (*to, (0..to.len as usize).map(name).collect())
            }
            Op::Combine(Combine { left, right, to, .. }) => {
                let other = |i| if right.len == 1 { at(right, 0) } else { at(right, i) };
                let name = |i| names.of(vec![4, at(left, i), other(i)]);
                (*to, (0..to.len as usize).map(name).collect())
            }
            Op::Select(Select { condition, yes, no, to }) => {
                let name = |i| names.of(vec![5, at(condition, i), at(yes, i), at(no, i)]);
                (*to, (0..to.len as usize).map(name).collect())
            }
            Op::Arrange(Arrange { from, to, sizes, .. }) => {
                (*to, (0..sizes[3] as usize).map(|i| at(from, i)).collect())
            }
            _ => continue,
        };
        memory[to.offset as usize..][..values.len()].copy_from_slice(&values);
    }
    for op in ops {
        let read = match op {
            Op::Output(Output { from, width, .. }) => Place { len: *width, ..*from },
            Op::MaskedArgmax(MaskedArgmax { from }) => *from,
            Op::State(State { to, .. }) => *to,
            _ => continue,
        };
        results.push(memory[read.offset as usize..][..read.len as usize].to_vec());
    }
    results
}

/// Inputs and states, some read and some not, steps that write whole values and parts, two outputs and a choice.
fn program(random: &mut Random) -> (Vec<Op>, Vec<Place>) {
    const LENGTHS: [usize; 3] = [5, 16, 40];
    let (mut arena, mut ops, mut values) = (Arena::default(), Vec::new(), Vec::new());
    for index in 0..1 + random.below(3) {
        let to = arena.place(LENGTHS[random.below(3)]);
        ops.push(Op::Input(Input { index: index as u16, meaning: Meaning::None, to }));
        values.push(to);
    }
    for _ in 0..random.below(3) {
        let from = arena.place(LENGTHS[random.below(3)]);
        ops.push(Op::State(State { from, to: from }));
        values.push(from);
    }
    for tag in 0..3 + random.below(15) as u32 {
        let from = values[random.below(values.len())];
        let to = arena.place(from.len as usize);
        let alike: Vec<Place> = values.iter().filter(|v| v.len == from.len).copied().collect();
        let mut other = || alike[random.below(alike.len())];
        let (yes, right) = (other(), other());
        let single = Place { len: 1, ..values[random.below(values.len())] };
        match random.below(5) {
            0 => ops.push(Op::Select(Select { condition: from, yes, no: right, to })),
            1 => {
                // Two values beside each other.
                let to = arena.place(from.len as usize + yes.len as usize);
                for (from, skipped) in [(from, 0), (yes, from.len)] {
                    let sizes = [1, 1, 1, from.len];
                    let (from_strides, to_strides) = ([0, 0, 0, 1], [0, 0, 0, 1]);
                    let to = Place { offset: to.offset + skipped, len: to.len - skipped };
                    let part = Arrange { from, to, sizes, from_strides, to_strides };
                    ops.push(Op::Arrange(part));
                }
                values.push(to);
                continue;
            }
            2 | 3 => {
                let right = if random.below(3) == 0 { single } else { right };
                let combination = Combination::Add;
                ops.push(Op::Combine(Combine { combination, left: from, right, to }));
            }
            _ => ops.push(Op::Map(Map { function: Function::Relu, a: tag, b: 0, from, to })),
        }
        values.push(to);
    }
    for op in &mut ops {
        let Op::State(state) = op else { continue };
        let next: Vec<Place> = values.iter().filter(|v| v.len == state.from.len).copied().collect();
        state.to = next[random.below(next.len())];
    }
    for _ in 0..2 {
        let from = values[random.below(values.len())];
        let (width, rows, groups) = (from.len, OutputRows::One, 0);
        ops.push(Op::Output(Output { from, width, rows, groups }));
    }
    ops.push(Op::MaskedArgmax(MaskedArgmax { from: values[random.below(values.len())] }));
    (ops, arena.places)
}

#[test]
fn tidied_programs_compute_the_same_in_fewer_floats() {
    let mut random = Random::new(11);
    let (mut before, mut after) = (0, 0);
    for _ in 0..2_000 {
        let (mut ops, blocks) = program(&mut random);
        let last = blocks.last().expect("a value");
        let mut names = Names::default();
        let floats = (last.offset + last.len) as usize;
        let want = computed(&ops, floats, &mut names);
        let (steps, tidied) = (ops.clone(), tidy(&mut ops, &blocks));
        let got = computed(&ops, tidied as usize, &mut names);
        assert_eq!(got, want, "{steps:?}\nbecame {ops:?}");
        let starts = ops.iter().filter_map(|op| match op {
            Op::Map(map) => Some(map.to.offset),
            _ => None,
        });
        assert!(starts.into_iter().all(|start| start.is_multiple_of(ALIGN)));
        (before, after) = (before + floats, after + tidied as usize);
    }
    assert!(after * 10 < before * 6, "{after} of {before}");
}
