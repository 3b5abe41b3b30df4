//! Attention to everything that is seen and, for imagination, to its two parts, at the price of one.
//!
//! A partition splits what a query sees into the rows *within* its part and those *across*. Scores are
//! taken once, and each part has a softmax of its own. The softmax over both is the same but for one
//! number a head, the share of the mass that lies within, so that what the query gets from everything is
//! `share * within + (1 - share) * across`: exact, and no pair is looked at twice.

use std::hint::black_box;

use sortie_core::internal::math::exp;

use super::attention::{Backward, Forward};
use super::lists::VisibleLists;
use super::vectors::run_widest;

/// The queries' outputs, one behind the other: from everything and, with imagination, from within and
/// from across.
pub const BLOCKS: usize = 3;
/// Attention heads, as in all experiments of the dissertation.
pub const HEADS: usize = 4;

/// The widths that attention is built for.
pub const WIDTHS: [usize; 4] = [16, 32, 64, 128];

/// Whether attention of so many heads at a width can be had here: the same bits as [`attention`](super::attention)'s, in
/// less time.
pub(crate) fn is_built_for(width: usize, heads: usize) -> bool {
    heads == HEADS && WIDTHS.contains(&width)
}

/// Attends, at a width of 16, 32, 64 or 128. There are three blocks of output `[queries, width]`, or the first, as many as it
/// has room for; weights are each part's own, and shares those of the mass within.
pub(crate) fn forward(width: usize, lists: &VisibleLists, pass: Forward<'_>) {
    run_widest(
        #[inline(always)]
        || match width {
            16 => attend::<4>(lists, pass),
            32 => attend::<8>(lists, pass),
            64 => attend::<16>(lists, pass),
            128 => attend::<32>(lists, pass),
            width => panic!("no attention of width {width}"),
        },
    );
}

/// Numbers of every head.
type Heads = [f32; HEADS];
/// A query, key or value.
type Vector<const HEAD: usize> = [[f32; HEAD]; HEADS];

/// Vector `index` of those that stand behind each other.
#[inline(always)]
fn vector<const HEAD: usize>(vectors: &[f32], index: usize) -> &Vector<HEAD> {
    let (heads, _) = vectors[index * HEADS * HEAD..][..HEADS * HEAD].as_chunks::<HEAD>();
    heads.first_chunk().expect("a part per head")
}

/// As [`vector`], to be changed.
#[inline(always)]
fn vector_mut<const HEAD: usize>(vectors: &mut [f32], index: usize) -> &mut Vector<HEAD> {
    let (heads, _) = vectors[index * HEADS * HEAD..][..HEADS * HEAD].as_chunks_mut::<HEAD>();
    heads.first_chunk_mut().expect("a part per head")
}

/// Adds to `sum` a vector times a factor per head.
#[inline(always)]
fn add<const HEAD: usize>(sum: &mut Vector<HEAD>, factors: &Heads, values: &Vector<HEAD>) {
    for head in 0..HEADS {
        for i in 0..HEAD {
            sum[head][i] += factors[head] * values[head][i];
        }
    }
}

/// The dot product of every head, in four lanes each.
///
/// The compiler would rather add up the same lane of all heads, and shuffle every product for that: it is to have the sums
/// before it sees how they are joined.
#[inline(always)]
fn dot<const HEAD: usize>(one: &Vector<HEAD>, other: &Vector<HEAD>) -> Heads {
    let mut sums = [[0.0; 4]; HEADS];
    for ((sums, one), other) in sums.iter_mut().zip(one).zip(other) {
        let ((one, _), (other, _)) = (one.as_chunks::<4>(), other.as_chunks::<4>());
        for (one, other) in one.iter().zip(other) {
            for lane in 0..4 {
                sums[lane] += one[lane] * other[lane];
            }
        }
    }
    black_box(sums).map(|[a, b, c, d]| (a + c) + (b + d))
}

#[inline(always)]
fn attend<const HEAD: usize>(lists: &VisibleLists, pass: Forward<'_>) {
    let scale = 1.0 / (HEAD as f32).sqrt();
    let agents = lists.queries();
    let imagines = pass.output.len() > agents * HEADS * HEAD;
    let (weights, _) = pass.of_pairs.as_chunks_mut::<HEADS>();
    let (shares, _) = pass.shares.as_chunks_mut::<HEADS>();
    for (query, (start, list, split)) in lists.each().enumerate() {
        let weights = &mut weights[start..][..list.len()];
        let own = vector::<HEAD>(pass.queries, query);
        for (row, weights) in list.iter().zip(&mut *weights) {
            let key = vector(pass.keys_values, 2 * *row as usize);
            *weights = dot(own, key).map(|score| scale * score);
        }
        if !imagines {
            softmax(weights);
            *vector_mut(pass.output, query) = sum::<HEAD>(list, weights, pass.keys_values);
            continue;
        }
        let (inner, outer) = weights.split_at_mut(split);
        let share = share(softmax(inner), softmax(outer));
        shares[query] = share;
        let within = sum::<HEAD>(&list[..split], inner, pass.keys_values);
        let across = sum::<HEAD>(&list[split..], outer, pass.keys_values);
        *vector_mut(pass.output, agents + query) = within;
        *vector_mut(pass.output, 2 * agents + query) = across;
        let everything = vector_mut(pass.output, query);
        *everything = [[0.0; HEAD]; HEADS];
        add(everything, &share, &within);
        add(everything, &share.map(|share| 1.0 - share), &across);
    }
}

/// The sum of the listed values, weighted.
#[inline(always)]
fn sum<const HEAD: usize>(list: &[u32], weights: &[Heads], keys_values: &[f32]) -> Vector<HEAD> {
    let mut sum = [[0.0; HEAD]; HEADS];
    for (row, weights) in list.iter().zip(weights) {
        add(&mut sum, weights, vector(keys_values, 2 * *row as usize + 1));
    }
    sum
}

/// The mass of a softmax: the largest score, and the sum of `exp(score - largest)`.
#[derive(Clone, Copy)]
struct Mass {
    largest: Heads,
    sum: Heads,
}

/// Softmax over the pairs of each head, in place. An empty list has no mass.
#[inline(always)]
fn softmax(scores: &mut [Heads]) -> Mass {
    let mut mass = Mass { largest: [f32::NEG_INFINITY; HEADS], sum: [0.0; HEADS] };
    for scores in scores.iter() {
        for (largest, score) in mass.largest.iter_mut().zip(scores) {
            *largest = if *score > *largest { *score } else { *largest };
        }
    }
    each(scores, &mass.largest, |score, largest| exp(score - largest));
    for weights in scores.iter() {
        for (sum, weight) in mass.sum.iter_mut().zip(weights) {
            *sum += weight;
        }
    }
    each(scores, &mass.sum.map(|sum| 1.0 / sum), |weight, factor| weight * factor);
    mass
}

/// Makes something of every number and of what its head has, two pairs at a time: told no more than that there are four
/// heads, the compiler takes eight pairs apart by head and puts them together again, which costs more than the rest.
#[inline(always)]
fn each(numbers: &mut [Heads], of_heads: &Heads, make: impl Fn(f32, f32) -> f32) {
    let twice: [f32; 2 * HEADS] = std::array::from_fn(|lane| of_heads[lane % HEADS]);
    let (pairs, last) = numbers.as_flattened_mut().as_chunks_mut::<{ 2 * HEADS }>();
    for pair in pairs {
        *pair = std::array::from_fn(|lane| make(pair[lane], twice[lane]));
    }
    for (number, of_head) in last.iter_mut().zip(of_heads) {
        *number = make(*number, *of_head);
    }
}

/// The share of the first of two masses.
#[inline(always)]
fn share(first: Mass, second: Mass) -> Heads {
    std::array::from_fn(|head| {
        if first.sum[head] == 0.0 {
            return 0.0;
        }
        if second.sum[head] == 0.0 {
            return 1.0;
        }
        let largest = first.largest[head].max(second.largest[head]);
        let size = |mass: &Mass| mass.sum[head] * exp(mass.largest[head] - largest);
        let (first, second) = (size(&first), size(&second));
        first / (first + second)
    })
}

/// Writes the gradients of queries, keys and values.
pub(crate) fn backward(width: usize, lists: &VisibleLists, pass: Backward<'_>) {
    run_widest(
        #[inline(always)]
        || match width {
            16 => descend::<4>(lists, pass),
            32 => descend::<8>(lists, pass),
            64 => descend::<16>(lists, pass),
            128 => descend::<32>(lists, pass),
            width => panic!("no attention of width {width}"),
        },
    );
}

#[inline(always)]
fn descend<const HEAD: usize>(lists: &VisibleLists, pass: Backward<'_>) {
    let agents = lists.queries();
    let scale = 1.0 / (HEAD as f32).sqrt();
    let imagines = pass.d_output.len() > agents * HEADS * HEAD;
    pass.d_keys_values.fill(0.0);
    let (weights, _) = pass.of_pairs.as_chunks::<HEADS>();
    let (shares, _) = pass.shares.as_chunks::<HEADS>();
    let (d_scores, _) = pass.d_scores.as_chunks_mut::<HEADS>();
    for (query, (start, list, split)) in lists.each().enumerate() {
        let weights = &weights[start..][..list.len()];
        let d_scores = &mut d_scores[start..][..list.len()];
        let d_all = vector::<HEAD>(pass.d_output, query);
        if imagines {
            let part = |tensor, part: usize| vector::<HEAD>(tensor, part * agents + query);
            let (mut d_within, mut d_across) = (*part(pass.d_output, 1), *part(pass.d_output, 2));
            let share = &shares[query];
            add(&mut d_within, share, d_all);
            add(&mut d_across, &share.map(|share| 1.0 - share), d_all);
            let gains = [1, 2].map(|it| dot(d_all, part(pass.output, it)));
            let d_mass = std::array::from_fn(|head| {
                share[head] * (1.0 - share[head]) * (gains[0][head] - gains[1][head])
            });
            let (inner_list, outer_list) = list.split_at(split);
            let (inner, outer) = weights.split_at(split);
            let (d_inner, d_outer) = d_scores.split_at_mut(split);
            let values = (pass.keys_values, &mut *pass.d_keys_values);
            descend_part((inner_list, inner), &d_within, &d_mass, values, d_inner);
            let values = (pass.keys_values, &mut *pass.d_keys_values);
            let d_mass = d_mass.map(|d| -d);
            descend_part((outer_list, outer), &d_across, &d_mass, values, d_outer);
        } else {
            let values = (pass.keys_values, &mut *pass.d_keys_values);
            descend_part((list, weights), d_all, &[0.0; HEADS], values, d_scores);
        }
        let own = vector::<HEAD>(pass.queries, query);
        let mut d_own = [[0.0; HEAD]; HEADS];
        for (row, d_score) in list.iter().zip(&*d_scores) {
            let d_score = d_score.map(|d| scale * d);
            add(&mut d_own, &d_score, vector(pass.keys_values, 2 * *row as usize));
            add(vector_mut(pass.d_keys_values, 2 * *row as usize), &d_score, own);
        }
        *vector_mut(pass.d_queries, query) = d_own;
    }
}

/// Adds to the gradients of the values that a softmax weighs and writes those of the scores, for a loss with these slopes by
/// the weighted sum and by the logarithm of the mass.
#[inline(always)]
fn descend_part<const HEAD: usize>(
    (list, weights): (&[u32], &[Heads]),
    d_sum: &Vector<HEAD>,
    d_mass: &Heads,
    (keys_values, d_keys_values): (&[f32], &mut [f32]),
    d_scores: &mut [Heads],
) {
    let mut total = d_mass.map(|d| -d);
    for ((row, weights), d_score) in list.iter().zip(weights).zip(&mut *d_scores) {
        let value = 2 * *row as usize + 1;
        *d_score = dot(d_sum, vector(keys_values, value));
        add(vector_mut(d_keys_values, value), weights, d_sum);
        for head in 0..HEADS {
            total[head] += weights[head] * d_score[head];
        }
    }
    each(d_scores, &total, |d_score, total| d_score - total);
    for (d_score, weight) in d_scores.as_flattened_mut().iter_mut().zip(weights.as_flattened()) {
        *d_score *= weight;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gradient_check::random;
    use crate::layers::attention::{self, AttentionShape};

    const ROWS: usize = 13;

    /// Lists of odd and even lengths.
    fn lists() -> VisibleLists {
        let mut lists = VisibleLists::default();
        for length in [1, 2, 3, 8, ROWS] {
            (0..length).for_each(|place| lists.push((5 * place + length) % ROWS));
            lists.end_list();
        }
        lists
    }

    fn bits(numbers: &[f32]) -> Vec<u32> {
        numbers.iter().map(|number| number.to_bits()).collect()
    }

    fn blank(count: usize) -> Vec<f32> {
        vec![f32::NAN; count]
    }

    #[test]
    fn without_parts_all_bits_are_those_of_attention() {
        let lists = lists();
        let (agents, pairs) = (lists.queries(), HEADS * lists.pairs());
        for width in WIDTHS {
            assert!(is_built_for(width, HEADS) && !is_built_for(width, 2));
            let shape = AttentionShape { width, heads: HEADS };
            let queries = &*random(1, agents * width);
            let keys_values = &*random(2, ROWS * 2 * width);
            let attended = |attend: &dyn Fn(Forward<'_>)| {
                let (mut of_pairs, mut output) = (blank(pairs), blank(agents * width));
                let (of_pairs_here, shares) = (&mut *of_pairs, &mut [][..]);
                attend(Forward {
                    queries,
                    keys_values,
                    of_pairs: of_pairs_here,
                    shares,
                    output: &mut output,
                });
                (of_pairs, bits(&output))
            };
            let (weights, output) = attended(&|pass| attention::forward(shape, &lists, pass));
            let (others, other) = attended(&|pass| forward(width, &lists, pass));
            assert_eq!((bits(&weights), output), (bits(&others), other), "{width}");

            let (d_output, of_pairs) = (&*random(3, agents * width), &*weights);
            let slopes = |descend: &dyn Fn(Backward<'_>)| {
                let sizes = [pairs, queries.len(), keys_values.len()];
                let [mut d_scores, mut d_queries, mut d_keys_values] = sizes.map(blank);
                descend(Backward {
                    queries,
                    keys_values,
                    of_pairs,
                    shares: &[],
                    output: &[],
                    d_output,
                    d_scores: &mut d_scores,
                    d_queries: &mut d_queries,
                    d_keys_values: &mut d_keys_values,
                });
                [d_queries, d_keys_values].map(|slopes| bits(&slopes))
            };
            let want = slopes(&|pass| attention::backward(shape, &lists, pass));
            let found = slopes(&|pass| backward(width, &lists, pass));
            assert_eq!(found, want, "{width}");
        }
    }
}
