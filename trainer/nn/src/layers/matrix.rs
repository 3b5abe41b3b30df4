//! Matrix products on borrowed slices, checked at the door, computed by the kernels of the `gemm` crates.

use std::ops::Range;

use super::products::{self, Place};

/// A read-only view of a matrix in a slice; element (i, j) stands at `i * row_stride + j * column_stride`.
#[derive(Clone, Copy, Debug)]
pub struct Matrix<'a> {
    data: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a> Matrix<'a> {
    /// Views `data` as a row-major matrix. Panics if it is shorter than `rows * columns`.
    #[inline]
    pub fn new(data: &'a [f32], rows: usize, columns: usize) -> Self {
        Self { data: &data[..rows * columns], rows, columns, row_stride: columns, column_stride: 1 }
    }

    /// Some columns of a matrix that was not transposed. Panics if the range reaches beyond it.
    #[inline]
    pub fn columns(self, range: Range<usize>) -> Self {
        assert!(range.start <= range.end && range.end <= self.columns, "columns out of range");
        let start = range.start.min(self.data.len());
        Self { data: &self.data[start..], columns: range.len(), ..self }
    }

    /// The same elements with rows and columns exchanged; nothing is moved.
    #[inline]
    pub fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }
}

/// A view of a row-major matrix to be written.
#[derive(Debug)]
pub struct MatrixMut<'a> {
    data: &'a mut [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
}

impl<'a> MatrixMut<'a> {
    /// Views `data` as a row-major matrix. Panics if it is shorter than `rows * columns`.
    #[inline]
    pub fn new(data: &'a mut [f32], rows: usize, columns: usize) -> Self {
        Self { data: &mut data[..rows * columns], rows, columns, row_stride: columns }
    }

    /// Some columns of this matrix. Panics if the range reaches beyond it.
    #[inline]
    pub fn columns(self, range: Range<usize>) -> Self {
        assert!(range.start <= range.end && range.end <= self.columns, "columns out of range");
        let start = range.start.min(self.data.len());
        Self { data: &mut self.data[start..], columns: range.len(), ..self }
    }
}

/// Whether a product replaces what stood in its destination or is added to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Store {
    /// `out = product`
    Replace,
    /// `out = out + product`
    Add,
}

/// Computes the product of `left` and `right` on the calling thread.
///
/// Panics if the shapes do not fit. The last bits depend on the thread's
/// [`Products`](super::products::Products) only.
pub fn multiply(out: MatrixMut<'_>, store: Store, left: Matrix<'_>, right: Matrix<'_>) {
    assert_eq!(out.rows, left.rows, "rows of the product");
    assert_eq!(out.columns, right.columns, "columns of the product");
    assert_eq!(left.columns, right.rows, "inner dimension of the product");
    if out.rows == 0 || out.columns == 0 {
        return;
    }
    // The views are private and only made by the constructors above, which bound every element; the
    // last element of each is asserted once more because the kernel trusts these numbers.
    assert!((out.rows - 1) * out.row_stride + out.columns <= out.data.len());
    for view in [left, right] {
        let last = |count: usize, stride: usize| count.saturating_sub(1) * stride;
        assert!(
            view.columns == 0
                || view.rows == 0
                || last(view.rows, view.row_stride) + last(view.columns, view.column_stride)
                    < view.data.len()
        );
    }
    let place = |view: Matrix<'_>| Place {
        first: view.data.as_ptr(),
        rows: view.row_stride as isize,
        columns: view.column_stride as isize,
    };
    let written = Place { first: out.data.as_mut_ptr(), rows: out.row_stride as isize, columns: 1 };
    let sizes = [out.rows, out.columns, left.columns];
    #[expect(unsafe_code, reason = "the kernels of products take raw pointers")]
    // SAFETY: every element the kernel touches lies at i * row_stride + j * column_stride with i and j
    // inside the shapes asserted equal above, and the largest such offset is asserted to lie inside
    // each slice. `out` is borrowed mutably, so it overlaps neither input. Strides fit isize because
    // they are below slice lengths.
    unsafe {
        products::multiply(sizes, written, store == Store::Add, place(left), place(right));
    }
}

#[cfg(test)]
mod tests {
    use super::super::products::Products;
    use super::*;

    fn naive(left: Matrix<'_>, right: Matrix<'_>) -> Vec<f32> {
        let at =
            |m: &Matrix<'_>, i: usize, j: usize| m.data[i * m.row_stride + j * m.column_stride];
        let mut out = vec![0.0; left.rows * right.columns];
        for i in 0..left.rows {
            for j in 0..right.columns {
                out[i * right.columns + j] =
                    (0..left.columns).map(|k| at(&left, i, k) * at(&right, k, j)).sum();
            }
        }
        out
    }

    fn ramp(count: usize, scale: f32) -> Vec<f32> {
        (0..count).map(|i| ((i * 7 % 13) as f32 - 6.0) * scale).collect()
    }

    fn assert_close(got: &[f32], want: &[f32]) {
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() < 1e-4, "{got} against {want}");
        }
    }

    #[test]
    fn agrees_with_the_naive_product_for_all_transpositions() {
        let (a, b) = (ramp(5 * 9, 0.1), ramp(9 * 4, 0.2));
        for products in Products::ALL.into_iter().filter(|products| products.are_available()) {
            products.use_here();
            for (left, right) in [
                (Matrix::new(&a, 5, 9), Matrix::new(&b, 9, 4)),
                (Matrix::new(&a, 5, 9), Matrix::new(&b, 4, 9).transposed()),
                (Matrix::new(&a, 9, 5).transposed(), Matrix::new(&b, 9, 4)),
            ] {
                let mut out = vec![f32::NAN; 20];
                multiply(MatrixMut::new(&mut out, 5, 4), Store::Replace, left, right);
                assert_close(&out, &naive(left, right));
            }
        }
    }

    #[test]
    fn adds_into_some_columns_and_leaves_the_others() {
        let (a, b) = (ramp(3 * 2, 0.5), ramp(2 * 2, 0.25));
        let (left, right) = (Matrix::new(&a, 3, 2), Matrix::new(&b, 2, 2));
        let mut out = vec![1.0; 3 * 5];
        multiply(MatrixMut::new(&mut out, 3, 5).columns(2..4), Store::Add, left, right);
        for (row, want) in out.chunks(5).zip(naive(left, right).chunks(2)) {
            assert_eq!([row[0], row[1], row[4]], [1.0; 3]);
            assert_close(&row[2..4], &[want[0] + 1.0, want[1] + 1.0]);
        }
    }

    #[test]
    fn every_width_gives_its_own_bits_whatever_was_computed_before() {
        let (a, b) = (ramp(70 * 90, 0.013), ramp(90 * 40, 0.017));
        let product = |products: Products| {
            products.use_here();
            let mut out = vec![f32::NAN; 70 * 40];
            let (left, right) = (Matrix::new(&a, 70, 90), Matrix::new(&b, 90, 40));
            multiply(MatrixMut::new(&mut out, 70, 40), Store::Replace, left, right);
            out.into_iter().map(f32::to_bits).collect::<Vec<_>>()
        };
        let available = || Products::ALL.into_iter().filter(|products| products.are_available());
        let first: Vec<_> = available().map(product).collect();
        assert_eq!(available().map(product).collect::<Vec<_>>(), first);
    }

    #[test]
    fn an_empty_inner_dimension_gives_zeros() {
        let mut out = vec![3.0; 4];
        let (left, right) = (Matrix::new(&[], 2, 0), Matrix::new(&[], 0, 2));
        multiply(MatrixMut::new(&mut out, 2, 2), Store::Replace, left, right);
        assert_eq!(out, [0.0; 4]);
    }

    #[test]
    #[should_panic(expected = "inner dimension")]
    fn refuses_shapes_that_do_not_fit() {
        let data = [0.0; 8];
        let mut out = [0.0; 4];
        let (left, right) = (Matrix::new(&data, 2, 4), Matrix::new(&data, 2, 2));
        multiply(MatrixMut::new(&mut out, 2, 2), Store::Replace, left, right);
    }
}
