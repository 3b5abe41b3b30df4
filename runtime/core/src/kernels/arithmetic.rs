//! How a product is added to a sum: the one difference between the f32 profiles.

/// The rounding of multiply-adds; everything else, their order included, is the same for all.
pub trait Arithmetic {
    /// Whether product and sum are rounded once.
    const FUSED: bool;

    /// `sum + a * b`.
    fn multiply_add(sum: f32, a: f32, b: f32) -> f32;
}

/// Product and sum are each rounded: the same bits on every target.
#[derive(Clone, Copy, Debug)]
pub enum Exact {}

impl Arithmetic for Exact {
    const FUSED: bool = false;

    #[inline(always)]
    fn multiply_add(sum: f32, a: f32, b: f32) -> f32 {
        sum + a * b
    }
}

/// Rounded once, as IEEE 754 defines it: the same bits on every target that has the instruction.
#[cfg(any(test, feature = "std"))]
#[derive(Clone, Copy, Debug)]
pub enum Fused {}

#[cfg(any(test, feature = "std"))]
impl Arithmetic for Fused {
    const FUSED: bool = true;

    #[inline(always)]
    fn multiply_add(sum: f32, a: f32, b: f32) -> f32 {
        a.mul_add(b, sum)
    }
}
