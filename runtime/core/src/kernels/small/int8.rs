//! Products of int8 weights where there are no vectors: eight columns at a time.

use zerocopy::{FromBytes, IntoBytes};

use super::Small;
use crate::kernels::int8::{
    Int8Kernels, Matrix, NOTHING, PAIRS, Pair, Row, Scale, SparseVector, Vector, input_max,
};
use crate::math::relu_all;

/// Columns whose sums are kept together.
const PART: usize = 8;

/// Most pairs of inputs that are listed as not zero: rows of features have few.
const LISTED: usize = 48;

/// Weights of two columns for a pair of inputs: of each column the first input's, then the second's.
type Columns = u32;

impl<A, const SKIPS: bool> Int8Kernels for Small<A, SKIPS> {
    #[inline(never)]
    fn quantise(self, values: &[f32], least: f32, integers: &mut [i16]) -> Option<Scale> {
        let magnitude = |value: &f32| value.to_bits() & 0x7fff_ffff;
        let largest = values.iter().map(magnitude).fold(least.to_bits(), u32::max);
        if largest >= 0x7f80_0000 {
            return None;
        }
        let (largest, most) = (f32::from_bits(largest), f32::from(input_max(integers.len())));
        let scale = if largest > NOTHING {
            Scale { factor: most / largest, step: largest / most }
        } else {
            Scale { factor: 0.0, step: 0.0 }
        };
        integers.fill(0);
        for (place, value) in integers.iter_mut().zip(values) {
            if !SKIPS || value.to_bits() != 0 {
                *place = scale.integer(*value);
            }
        }
        Some(scale)
    }

    #[inline(never)]
    fn int8_products(self, matrix: &Matrix<'_>, vectors: &mut [Vector<'_>]) {
        let strips = matrix.rows.chunks_exact((matrix.groups * PAIRS).max(1));
        for vector in vectors {
            let (parts, _) = vector.outputs.as_chunks_mut();
            for (part, outputs) in parts.iter_mut().enumerate() {
                let Some(strip) = strips.clone().nth(part / 2) else { break };
                let mut sums = [0; PART];
                for (row, pair) in halves(strip).iter().zip(vector.inputs.as_flattened()) {
                    if let (Some(columns), true) = (row.get(part & 1), *pair != [0; 2]) {
                        add(&mut sums, columns, *pair);
                    }
                }
                *outputs = finished(matrix, part, sums, vector.step);
            }
        }
    }

    #[inline(never)]
    fn int8_sparse_product(self, matrix: &Matrix<'_>, vector: SparseVector<'_>) -> Option<()> {
        let SparseVector { values, one, integers, outputs } = vector;
        // The one is an input as well.
        let least = if one.is_some() { 1.0 } else { 0.0 };
        let scale = self.quantise(values, least, integers)?;
        if let Some(place) = one.and_then(|one| integers.get_mut(one)) {
            *place = scale.integer(1.0);
        }
        let (parts, _) = outputs.as_chunks_mut();
        let strips = parts.len().div_ceil(2);
        let pairs: &[Pair] = integers.as_chunks().0;
        let mut list = [(0, [0; 2]); LISTED];
        let (listed, rest) = nonzero(pairs, strips, &mut list);
        let all = halves(matrix.rows);
        for (part, outputs) in parts.iter_mut().enumerate() {
            let rows = all.get(part / 2..)?;
            let mut sums = [0; PART];
            for (row, pair) in listed {
                add(&mut sums, rows.get(*row as usize)?.get(part & 1)?, *pair);
            }
            let others = rows.get((pairs.len() - rest.len()) * strips..).unwrap_or(&[]);
            for (row, pair) in others.iter().step_by(strips.max(1)).zip(rest) {
                add(&mut sums, row.get(part & 1)?, *pair);
            }
            *outputs = finished(matrix, part, sums, scale.step);
        }
        Some(())
    }
}

/// Lists the first pairs of inputs that are not zero, each with the first of its rows; those behind the last one that the list
/// has room for are returned as they are.
#[inline(always)]
fn nonzero<'l, 'p>(
    pairs: &'p [Pair],
    strips: usize,
    list: &'l mut [(u32, Pair); LISTED],
) -> (&'l [(u32, Pair)], &'p [Pair]) {
    let (mut count, mut row, mut rest) = (0, 0_u32, pairs);
    while let [pair, others @ ..] = rest {
        if *pair != [0; 2] {
            let Some(place) = list.get_mut(count) else { break };
            *place = (row, *pair);
            count += 1;
        }
        // Far from overflow: inputs and outputs are numbers of 16 bits.
        (row, rest) = (row.wrapping_add(strips as u32), others);
    }
    (list.get(..count).unwrap_or(&[]), rest)
}

/// Rows of weights, each as two times eight columns, whose words are aligned: weights are.
#[inline(always)]
fn halves(rows: &[Row]) -> &[[[Columns; PART / 2]; 2]] {
    <[_]>::ref_from_bytes(rows.as_bytes()).unwrap_or(&[])
}

/// Adds the products of a pair of inputs to the sums of eight columns.
#[cfg(not(all(feature = "dsp", target_arch = "arm")))]
#[inline(always)]
fn add(sums: &mut [i32; PART], columns: &[Columns; PART / 2], [first, second]: Pair) {
    let (first, second) = (i32::from(first), i32::from(second));
    for ([a, b], columns) in sums.as_chunks_mut::<2>().0.iter_mut().zip(columns) {
        let [a0, a1, b0, b1] = columns.to_le_bytes().map(|byte| i32::from(byte as i8));
        // Never wraps, see `input_max`.
        *a = a.wrapping_add(a0 * first + a1 * second);
        *b = b.wrapping_add(b0 * first + b1 * second);
    }
}

/// The same by the instructions for two halves of a register, together: so sums stay in registers.
#[cfg(all(feature = "dsp", target_arch = "arm"))]
#[allow(unsafe_code)]
#[inline(always)]
fn add(sums: &mut [i32; PART], columns: &[Columns; PART / 2], [first, second]: Pair) {
    let pair = u32::from(first as u16) | u32::from(second as u16) << 16;
    let [a, b, c, d, e, f, g, h] = sums;
    // SAFETY: four words are read, of the columns; the feature says that the processor has the instructions.
    unsafe {
        core::arch::asm!(
            "ldr {w}, [{columns}]",
            "sxtb16 {v}, {w}",
            "sxtb16 {w}, {w}, ror #8",
            "smlabb {a}, {v}, {pair}, {a}",
            "smlatb {b}, {v}, {pair}, {b}",
            "smlabt {a}, {w}, {pair}, {a}",
            "smlatt {b}, {w}, {pair}, {b}",
            "ldr {w}, [{columns}, #4]",
            "sxtb16 {v}, {w}",
            "sxtb16 {w}, {w}, ror #8",
            "smlabb {c}, {v}, {pair}, {c}",
            "smlatb {d}, {v}, {pair}, {d}",
            "smlabt {c}, {w}, {pair}, {c}",
            "smlatt {d}, {w}, {pair}, {d}",
            "ldr {w}, [{columns}, #8]",
            "sxtb16 {v}, {w}",
            "sxtb16 {w}, {w}, ror #8",
            "smlabb {e}, {v}, {pair}, {e}",
            "smlatb {f}, {v}, {pair}, {f}",
            "smlabt {e}, {w}, {pair}, {e}",
            "smlatt {f}, {w}, {pair}, {f}",
            "ldr {w}, [{columns}, #12]",
            "sxtb16 {v}, {w}",
            "sxtb16 {w}, {w}, ror #8",
            "smlabb {g}, {v}, {pair}, {g}",
            "smlatb {h}, {v}, {pair}, {h}",
            "smlabt {g}, {w}, {pair}, {g}",
            "smlatt {h}, {w}, {pair}, {h}",
            a = inout(reg) *a,
            b = inout(reg) *b,
            c = inout(reg) *c,
            d = inout(reg) *d,
            e = inout(reg) *e,
            f = inout(reg) *f,
            g = inout(reg) *g,
            h = inout(reg) *h,
            columns = in(reg) columns.as_ptr(),
            pair = in(reg) pair,
            v = out(reg) _,
            w = out(reg) _,
            options(pure, readonly, nostack, preserves_flags),
        );
    }
}

/// Makes numbers of the sums of a part's columns.
#[inline(always)]
fn finished(matrix: &Matrix<'_>, part: usize, sums: [i32; PART], step: f32) -> [f32; PART] {
    let of_part = |floats: &[f32]| floats.as_chunks::<PART>().0.get(part).copied();
    let steps = of_part(matrix.steps).unwrap_or([0.0; PART]);
    let mut numbers = matrix.bias.and_then(of_part).unwrap_or([0.0; PART]);
    for ((number, sum), weight_step) in numbers.iter_mut().zip(sums).zip(steps) {
        *number += sum as f32 * (step * weight_step);
    }
    if matrix.relu {
        relu_all(&mut numbers);
    }
    numbers
}
