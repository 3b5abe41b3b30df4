//! With which instructions matrix products are computed, and so with which bits.
//!
//! A wider register adds up a product's terms in another order, so that its last bits differ. Hence the width is
//! chosen and not found: a thread computes its products as [`Products::use_here`] told it, else as
//! [`Products::usual`] has it, and the threads of [`in_lanes`](crate::lanes::in_lanes) do as the thread does
//! that gives them work. All other loops of the layers give the same bits on every processor.

use std::cell::Cell;
use std::fmt;
use std::str::FromStr;

use gemm_common::Parallelism;
use gemm_common::gemm::gemm_basic_generic;
use gemm_common::simd::MixedSimd;

/// The instructions of matrix products.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Products {
    /// Numbers one by one, on every processor.
    Plain,
    /// Registers of 4 numbers: those of 64-bit ARM.
    Neon,
    /// Registers of 8 numbers: AVX2 with fused multiply-add.
    Avx2,
    /// Registers of 16 numbers: AVX-512.
    Avx512,
}

thread_local! {
    static HERE: Cell<Option<Products>> = const { Cell::new(None) };
}

impl Products {
    /// All of them, the widest last.
    pub const ALL: [Self; 4] = [Self::Plain, Self::Neon, Self::Avx2, Self::Avx512];

    /// The widest that this processor has.
    pub fn widest() -> Self {
        Self::ALL.into_iter().rfind(|products| products.are_available()).unwrap_or(Self::Plain)
    }

    /// The widest but AVX-512: those that nearly every processor of a kind gives the same bits with.
    pub fn usual() -> Self {
        let usual = |products: &Self| *products != Self::Avx512 && products.are_available();
        Self::ALL.into_iter().rfind(usual).unwrap_or(Self::Plain)
    }

    /// Whether this processor has the instructions.
    pub fn are_available(self) -> bool {
        match self {
            Self::Plain => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => gemm_common::simd::V3::try_new().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => gemm_common::simd::V4::try_new().is_some(),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => std::arch::is_aarch64_feature_detected!("neon"),
            #[allow(unreachable_patterns, reason = "those of other kinds of processors")]
            _ => false,
        }
    }

    /// Has the calling thread compute its products so. Panics if the processor cannot.
    pub fn use_here(self) {
        assert!(self.are_available(), "this processor has no {self} products");
        HERE.set(Some(self));
    }

    /// How the calling thread computes its products.
    #[inline]
    pub fn here() -> Self {
        HERE.get().unwrap_or_else(|| {
            let usual = Self::usual();
            HERE.set(Some(usual));
            usual
        })
    }
}

impl fmt::Display for Products {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(["plain", "neon", "avx2", "avx512"][*self as usize])
    }
}

impl FromStr for Products {
    type Err = ();

    fn from_str(name: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|products| products.to_string() == name).ok_or(())
    }
}

/// A matrix in memory: element (i, j) stands `i * rows + j * columns` numbers behind the first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place<P> {
    pub(super) first: P,
    pub(super) rows: isize,
    pub(super) columns: isize,
}

/// Computes `out = left right`, or adds it where `add` says so; the sizes are rows, columns and inner
/// dimension, none of the first two 0.
///
/// # Safety
///
/// All elements must lie in memory that may be read, and written for `out`, which none of the others overlaps.
#[expect(unsafe_code, reason = "the kernels of products take raw pointers")]
pub(super) unsafe fn multiply(
    [rows, columns, inner]: [usize; 3],
    out: Place<*mut f32>,
    add: bool,
    left: Place<*const f32>,
    right: Place<*const f32>,
) {
    // The kernels want columns of the product to lie close. One that lies by rows is that of the other
    // two, exchanged and transposed.
    let turned = |place: Place<*const f32>| Place {
        rows: place.columns,
        columns: place.rows,
        first: place.first,
    };
    let (rows, columns, out, left, right) = if out.columns < out.rows {
        let out = Place { rows: out.columns, columns: out.rows, first: out.first };
        (columns, rows, out, turned(right), turned(left))
    } else {
        (rows, columns, out, left, right)
    };
    let alpha = if add { 1.0 } else { 0.0 };
    let (out, out_columns, out_rows) = (out.first, out.columns, out.rows);
    /// The product by the kernels of a module, for registers of so many numbers.
    macro_rules! with {
        ($simd:ident, $module:ident, $numbers:literal) => {{
            use gemm_f32::microkernel::$module::f32::{H_M, H_N, H_UKR, MR_DIV_N, NR, UKR};
            let simd = <gemm_common::simd::$simd as MixedSimd<f32, f32, f32, f32>>::try_new();
            let simd = simd.expect("asked before it was chosen");
            // SAFETY: the caller's promise is what the function asks for, and the processor has its instructions.
            unsafe {
                gemm_basic_generic::<_, f32, $numbers, { MR_DIV_N * $numbers }, NR, MR_DIV_N, H_M, H_N>(
                    simd, rows, columns, inner,
                    out, out_columns, out_rows, add,
                    left.first, left.columns, left.rows,
                    right.first, right.columns, right.rows,
                    alpha, 1.0, false, false, false,
                    |a, b, c| a * b + c,
                    &UKR, &H_UKR, false, Parallelism::None,
                )
            }
        }};
    }
    match Products::here() {
        #[cfg(target_arch = "x86_64")]
        Products::Avx512 => with!(V4, avx512f, 16),
        #[cfg(target_arch = "x86_64")]
        Products::Avx2 => with!(V3, fma, 8),
        #[cfg(target_arch = "aarch64")]
        Products::Neon => with!(Scalar, neon, 4),
        // No other is ever used here.
        _ => with!(Scalar, scalar, 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_back() {
        for products in Products::ALL {
            assert_eq!(products.to_string().parse(), Ok(products));
        }
        assert_eq!("widest".parse::<Products>(), Err(()));
    }

    #[test]
    fn a_choice_holds_for_its_thread_only() {
        let usual = Products::here();
        let other = std::thread::spawn(|| {
            Products::Plain.use_here();
            Products::here()
        });
        assert_eq!(other.join().unwrap(), Products::Plain);
        assert_eq!(Products::here(), usual);
    }
}
