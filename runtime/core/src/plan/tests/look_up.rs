//! Rows of tables against looking them up one by one.

use std::vec;
use std::vec::Vec;

use super::Random;
use super::drafts::{Draft, numbers};
use crate::DecideError;
use crate::ops::{Choice, Flag, Function, LookUp, Map, Op, Place};
use crate::plan::PlanError;

/// Two tables of three rows `[2]`, looked up with so many indices each.
fn looked_up(
    choice: Choice,
    constant: bool,
    tables: &[f32],
    indices: &[f32],
) -> Result<Vec<f32>, DecideError> {
    let mut draft = Draft::default();
    let index_place = draft.input(indices.len());
    let table_place = draft.input(tables.len());
    let to = draft.place(2 * indices.len());
    let place = if constant {
        // Other numbers stand before them.
        draft.weights(&[-1.0; 5]);
        Place { offset: draft.weights(tables), len: tables.len() as u32 }
    } else {
        table_place
    };
    draft.push(Op::LookUp(LookUp {
        choice,
        constant: Flag::from(constant),
        tables: place,
        rows: 3,
        columns: 2,
        indices: index_place,
        to,
    }));
    draft.output(to);
    draft.respond(&[indices, tables], 2 * indices.len())
}

/// The row of three that a number means; none where it means no row.
fn row(choice: Choice, index: f32) -> Option<usize> {
    let named = if choice == Choice::Any { 3 } else { 2 };
    let found = (0..named).find(|row| {
        let from_end = *row as f32 - named as f32;
        index == *row as f32 || choice != Choice::FirstOrLast && index == from_end
    });
    found.or((choice != Choice::Any).then_some(2))
}

#[test]
fn every_index_takes_its_row_or_none() {
    let mut random = Random(11);
    let tables = numbers(&mut random, 12);
    let whole = [-4.0, -3.0, -2.0, -1.0, -0.0, 0.0, 1.0, 2.0, 3.0];
    let strange = [0.5, -0.5, -1e-9, 2.999, 1e10, -1e10, f32::MAX, f32::MIN, 4_294_967_296.0];
    for choice in [Choice::Any, Choice::AnyOrLast, Choice::FirstOrLast] {
        for constant in [false, true] {
            for index in whole.into_iter().chain(strange) {
                let indices = [0.0, index, index, 1.0];
                let got = looked_up(choice, constant, &tables, &indices);
                let Some(found) = row(choice, index) else {
                    assert_eq!(got, Err(DecideError::NoSuchRow { rows: 3 }), "{index}");
                    continue;
                };
                let rows = [0, found, 3 + found, 4];
                let want: Vec<f32> =
                    rows.iter().flat_map(|row| [tables[2 * row], tables[2 * row + 1]]).collect();
                assert_eq!(got, Ok(want), "{choice:?} of {index}");
            }
        }
    }
}

#[test]
fn what_is_not_a_number_is_no_row() {
    for (choice, want) in [
        (Choice::Any, Err(DecideError::NoSuchRow { rows: 3 })),
        (Choice::AnyOrLast, Ok(vec![7.0])),
        (Choice::FirstOrLast, Ok(vec![7.0])),
    ] {
        let mut draft = Draft::default();
        let (below_zero, to) = (draft.input(1), draft.place(1));
        let tables = Place { offset: draft.weights(&[5.0, 6.0, 7.0]), len: 3 };
        let (function, a, b, from) = (Function::Sqrt, 0, 0, below_zero);
        draft.push(Op::Map(Map { function, a, b, from, to: from }));
        let (constant, rows, columns, indices) = (Flag::Yes, 3, 1, below_zero);
        draft.push(Op::LookUp(LookUp { choice, constant, tables, rows, columns, indices, to }));
        draft.output(to);
        assert_eq!(draft.respond(&[&[-1.0]], 1), want);
    }
}

#[test]
fn tables_stay_inside_their_places() {
    let place = |offset, len| Place { offset, len };
    let on = |constant, tables, [rows, columns]: [u32; 2], indices, to| {
        let (choice, constant) = (Choice::AnyOrLast, Flag::from(constant));
        LookUp { choice, constant, tables, rows, columns, indices, to }
    };
    let (input, to) = (place(0, 4), place(64, 8));
    let right = [
        on(true, place(58, 6), [3, 2], input, to),
        on(true, place(0, 12), [3, 2], input, to),
        on(false, place(0, 3), [3, 1], place(0, 4), place(64, 4)),
    ];
    let wrong = [
        on(true, place(59, 6), [3, 2], input, to),
        on(true, place(u32::MAX, 6), [3, 2], input, to),
        on(true, place(0, 6), [0, 2], input, to),
        on(true, place(0, 6), [3, 0], input, place(64, 0)),
        on(true, place(0, 0), [3, 2], input, to),
        on(true, place(0, 7), [3, 2], input, to),
        on(true, place(0, 18), [3, 2], input, to),
        on(true, place(0, 6), [u32::MAX, u32::MAX], input, to),
        on(true, place(0, 6), [3, 2], input, place(64, 7)),
        on(true, place(0, 6), [3, 2], input, place(196, 8)),
        on(true, place(0, 6), [3, 2], input, place(2, 8)),
        on(false, place(0, 3), [3, 1], place(0, 4), place(2, 4)),
        on(false, place(198, 3), [3, 1], place(0, 4), place(64, 4)),
        // Nobody wrote this table.
        on(false, place(32, 3), [3, 1], place(0, 4), place(64, 4)),
    ];
    for (op, fits) in right.map(|op| (op, true)).into_iter().chain(wrong.map(|op| (op, false))) {
        let mut draft = Draft { weights: vec![0.0; 64], ..Draft::default() };
        draft.input(4);
        draft.program.floats = 200;
        draft.push(Op::LookUp(op));
        draft.output(place(64, 1));
        let refused = matches!(draft.refused(), Some(PlanError::ShapeMismatch { op: 1 }));
        assert_eq!(!refused, fits, "{op:?}: {:?}", draft.refused());
    }
}
