//! Steps that choose, order, add and join rows and columns.

use std::ops::Range;

use super::super::operation::{Indices, Operation};
use super::super::{Pass, Tape, Var};
use crate::layers::elementwise;
use crate::layers::matrix::Store;

impl Pass<'_> {
    /// Rows by their numbers, some perhaps several times.
    pub fn gather(&mut self, x: Var, rows: &[u32]) -> Var {
        let columns = self.size(x)[1];
        let indices = self.tape.store_indices(rows.iter().copied());
        self.step(Operation::Gather { x, indices }, x, [rows.len(), columns], |x, y| {
            for (row, y) in rows.iter().zip(y.chunks_exact_mut(columns)) {
                y.copy_from_slice(&x[*row as usize * columns..][..columns]);
            }
        })
    }

    /// So many rows, of which row `to[i]` is the sum of all rows i of `x`: sums over groups of any size.
    pub fn scatter(&mut self, x: Var, to: &[u32], rows: usize) -> Var {
        let [count, columns] = self.size(x);
        assert_eq!(count, to.len(), "a place for every row");
        let indices = self.tape.store_indices(to.iter().copied());
        self.step(Operation::Scatter { x, indices }, x, [rows, columns], |x, y| {
            y.fill(0.0);
            for (row, x) in to.iter().zip(x.chunks_exact(columns)) {
                let y = &mut y[*row as usize * columns..][..columns];
                elementwise::scale(1.0, x, Store::Add, y);
            }
        })
    }

    /// The sum of every so many rows.
    pub fn sum_groups(&mut self, x: Var, size: usize) -> Var {
        let [rows, columns] = self.size(x);
        assert_eq!(rows % size, 0, "whole groups");
        let indices = self.tape.store_indices((0..rows).map(|row| (row / size) as u32));
        self.step(Operation::Scatter { x, indices }, x, [rows / size, columns], |x, y| {
            y.fill(0.0);
            for (y, x) in y.chunks_exact_mut(columns).zip(x.chunks_exact(size * columns)) {
                x.chunks_exact(columns).for_each(|x| elementwise::scale(1.0, x, Store::Add, y));
            }
        })
    }

    /// The mean of every so many rows.
    pub fn mean_groups(&mut self, x: Var, size: usize) -> Var {
        let sum = self.sum_groups(x, size);
        self.scale(sum, 1.0 / size as f32)
    }

    /// The sum of all rows.
    pub fn sum_rows(&mut self, x: Var) -> Var {
        let rows = self.size(x)[0];
        self.sum_groups(x, rows)
    }

    /// The mean of all rows.
    pub fn mean_rows(&mut self, x: Var) -> Var {
        let rows = self.size(x)[0];
        self.mean_groups(x, rows)
    }

    /// The sum of every row.
    pub fn sum_columns(&mut self, x: Var) -> Var {
        let [rows, columns] = self.size(x);
        self.step(Operation::SumColumns { x }, x, [rows, 1], |x, y| {
            for (y, x) in y.iter_mut().zip(x.chunks_exact(columns)) {
                *y = x.iter().sum();
            }
        })
    }

    /// The mean of every row.
    pub fn mean_columns(&mut self, x: Var) -> Var {
        let columns = self.size(x)[1];
        let sum = self.sum_columns(x);
        self.scale(sum, 1.0 / columns as f32)
    }

    /// The number of one column of every row, such as the utility of the action that was chosen.
    pub fn pick(&mut self, x: Var, columns: &[u32]) -> Var {
        let [rows, width] = self.size(x);
        assert_eq!(rows, columns.len(), "a column for every row");
        let indices = self.tape.store_indices(columns.iter().copied());
        self.step(Operation::Pick { x, indices }, x, [rows, 1], |x, y| {
            for ((y, x), column) in y.iter_mut().zip(x.chunks_exact(width)).zip(columns) {
                *y = x[*column as usize];
            }
        })
    }

    /// Some columns behind each other.
    pub fn columns(&mut self, x: Var, columns: Range<usize>) -> Var {
        let [rows, width] = self.size(x);
        let operation = Operation::Columns { x, first: columns.start as u32 };
        self.step(operation, x, [rows, columns.len()], |x, y| {
            for (y, x) in y.chunks_exact_mut(columns.len()).zip(x.chunks_exact(width)) {
                y.copy_from_slice(&x[columns.clone()]);
            }
        })
    }

    /// The columns of several matrices beside each other.
    pub fn concat(&mut self, parts: &[Var]) -> Var {
        let parts = self.tape.store_indices(parts.iter().map(|part| part.0));
        self.join_columns(parts)
    }

    /// The rows of several matrices behind each other.
    pub fn stack(&mut self, parts: &[Var]) -> Var {
        let columns = parts.first().map_or(1, |part| self.size(*part)[1]);
        let first = self.tape.indices.len() as u32;
        for part in parts {
            let [rows, width] = self.size(*part);
            assert_eq!(width, columns, "columns of every part");
            let row = self.reshape(*part, rows * width);
            self.tape.indices.push(row.0);
        }
        let row = self.join_columns((first, first + parts.len() as u32));
        self.reshape(row, columns)
    }

    /// The columns of the matrices whose numbers stand among the tape's indices.
    fn join_columns(&mut self, parts: Indices) -> Var {
        let numbers = parts.0 as usize..parts.1 as usize;
        let part = |tape: &Tape, number: usize| Var(tape.indices[number]);
        let sizes = numbers.clone().map(|number| self.size(part(self.tape, number)));
        let (rows, width) = sizes.fold((0, 0), |sum, [rows, columns]| (rows, sum.1 + columns));
        let needs = numbers.clone().any(|number| self.tape.needs(part(self.tape, number)));
        let y = self.tape.push(Operation::Concat { parts }, rows, width, needs);
        let mut first = 0;
        for number in numbers {
            let part = part(self.tape, number);
            let (range, [count, columns]) = (self.tape.of(part).range(), self.size(part));
            assert_eq!(count, rows, "rows of every part");
            let (before, out) = self.tape.split(y);
            for (y, x) in out.chunks_exact_mut(width).zip(before[range].chunks_exact(columns)) {
                y[first..first + columns].copy_from_slice(x);
            }
            first += columns;
        }
        y
    }
}
