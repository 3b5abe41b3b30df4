//! The inner loops of the layers: sums of products, in a fixed order; and the widest build of such loops that the processor
//! offers.
//!
//! All are inlined into their callers, which are built a second time for AVX2: see [`run_widest`]. Without fused multiply-add
//! both builds give the same bits.

/// Adds `factor` times `values` to `out`.
#[inline(always)]
pub fn add_scaled(out: &mut [f32], factor: f32, values: &[f32]) {
    let (out, out_rest) = out.as_chunks_mut::<8>();
    let (values, values_rest) = values.as_chunks::<8>();
    for (out, values) in out.iter_mut().zip(values) {
        // A local copy: that nothing is written before all is read lets the compiler take all at once.
        let mut sums = *out;
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum += factor * value;
        }
        *out = sums;
    }
    for (out, value) in out_rest.iter_mut().zip(values_rest) {
        *out += factor * value;
    }
}

/// Adds to `out` the sum of every vector in `terms` times its factor.
#[inline(always)]
pub fn add_weighted_sum<'a>(
    out: &mut [f32],
    terms: impl Iterator<Item = (f32, &'a [f32])> + Clone,
) {
    match out.len() {
        64.. => add_in_blocks::<64>(out, terms),
        32.. => add_in_blocks::<32>(out, terms),
        16.. => add_in_blocks::<16>(out, terms),
        _ => add_in_blocks::<8>(out, terms),
    }
}

/// Goes through the terms once for every `LANES` columns, whose sums stay in registers meanwhile.
#[inline(always)]
fn add_in_blocks<'a, const LANES: usize>(
    out: &mut [f32],
    terms: impl Iterator<Item = (f32, &'a [f32])> + Clone,
) {
    let (blocks, rest) = out.as_chunks_mut::<LANES>();
    let mut column = 0;
    for block in blocks {
        let mut sums = *block;
        for (factor, values) in terms.clone() {
            let values = values[column..].first_chunk::<LANES>().expect("as long as the sum");
            for i in 0..LANES {
                sums[i] += factor * values[i];
            }
        }
        *block = sums;
        column += LANES;
    }
    for (factor, values) in terms {
        add_scaled(rest, factor, &values[column..]);
    }
}

/// Vectors whose dot products are taken at once.
const GROUP: usize = 4;

/// Writes the dot products of the vectors that stand behind each other in `a` and in `b`, as many as `out`; where `b` is one
/// of them, with each of those in `a`.
#[inline(always)]
pub fn dots(a: &[f32], b: &[f32], out: &mut [f32]) {
    let width = a.len() / out.len().max(1);
    let step = if b.len() == width { 0 } else { width };
    let pair = |index: usize| (&a[index * width..][..width], &b[index * step..][..width]);
    let (groups, rest) = out.as_chunks_mut::<GROUP>();
    let grouped = groups.len() * GROUP;
    for (index, group) in groups.iter_mut().enumerate() {
        *group = group_of_dots(|vector| pair(index * GROUP + vector));
    }
    for (index, out) in rest.iter_mut().enumerate() {
        [*out] = group_of_dots(|_| pair(grouped + index));
    }
}

/// Dot products in four lanes each, which are joined for all of them at once.
#[inline(always)]
fn group_of_dots<'a, const COUNT: usize>(
    pair: impl Fn(usize) -> (&'a [f32], &'a [f32]),
) -> [f32; COUNT] {
    let mut lanes = [[0.0_f32; 4]; COUNT];
    for (vector, lanes) in lanes.iter_mut().enumerate() {
        let (a, b) = pair(vector);
        let (a, a_rest) = a.as_chunks::<4>();
        let (b, b_rest) = b.as_chunks::<4>();
        for (a, b) in a.iter().zip(b) {
            for lane in 0..4 {
                lanes[lane] += a[lane] * b[lane];
            }
        }
        for ((lane, a), b) in lanes.iter_mut().zip(a_rest).zip(b_rest) {
            *lane += a * b;
        }
    }
    lanes.map(|[a, b, c, d]| (a + c) + (b + d))
}

/// Runs `work` with AVX2 where the processor has it; else as it is. What is to be built for both is `#[inline(always)]`,
/// `work` itself and all that it calls.
#[inline]
pub fn run_widest<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx2") {
        // SAFETY: the only obligation of calling a function with target features is that the processor has
        // them, which the line above asked.
        #[expect(unsafe_code, reason = "half of an update is loops, which AVX2 halves")]
        return unsafe { with_avx2(work) };
    }
    work()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2<R>(work: impl FnOnce() -> R) -> R {
    work()
}

/// The same of work that has a width: the usual ones are constants, which unrolls its loops and leaves no checks in them.
#[inline]
pub(super) fn run_with_width(width: usize, work: impl FnOnce(usize)) {
    run_widest(
        #[inline(always)]
        || match width {
            32 => work(32),
            64 => work(64),
            128 => work(128),
            width => work(width),
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradient_check::random;

    fn assert_close(got: &[f32], want: impl Iterator<Item = f32>) {
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() < 1e-5, "{got} against {want}");
        }
    }

    #[test]
    fn a_weighted_sum_covers_whole_blocks_and_the_rest() {
        for width in [3, 8, 16, 21, 40, 70] {
            let (start, values) = (random(1, width), random(2, 3 * width));
            let factors = [0.5, -2.0, 0.25];
            let terms = factors.into_iter().zip(values.chunks_exact(width));
            let sum = |j: usize| -> f32 {
                factors.iter().enumerate().map(|(i, factor)| factor * values[i * width + j]).sum()
            };
            let mut out = start.clone();
            add_weighted_sum(&mut out, terms);
            assert_close(&out, (0..width).map(|j| start[j] + sum(j)));
        }
    }

    #[test]
    fn dot_products_of_groups_and_of_the_rest_agree_with_plain_sums() {
        for (count, width) in [(4, 16), (1, 5), (6, 7), (11, 8)] {
            let (a, b) = (random(1, count * width), random(2, count * width));
            let mut out = vec![f32::NAN; count];
            dots(&a, &b, &mut out);
            let pairs = a.chunks_exact(width).zip(b.chunks_exact(width));
            let product = |(a, b): (&[f32], &[f32])| a.iter().zip(b).map(|(a, b)| a * b).sum();
            assert_close(&out, pairs.map(product));
            dots(&a, &b[..width], &mut out);
            assert_close(&out, a.chunks_exact(width).map(|a| product((a, &b[..width]))));
        }
    }
}
