//! Sums of products by the instructions of the DSP extension (Cortex-M4, M7 and later), each of which multiplies two pairs of int16
//! and adds both products. These loops are assembly as a whole: their sums need nearly all registers, and compilers spill some.
//!
//! Weights are laid out for them: of a word, bytes 0 and 2 are a column's weights of a pair of inputs, bytes 1 and 3 the next
//! column's ([`crate::ops::LAYOUT_INT8_DSP`]).

use core::arch::naked_asm;

use super::parts::{List, Listed, PART, Part};
use crate::kernels::int8::{Inputs, IntegerRows, PAIRS};

/// As [`super::sums::of_all`].
#[allow(unsafe_code)]
#[inline(always)]
pub(super) fn of_all(rows: &[[Part; 2]], half: usize, inputs: &[Inputs], sums: &mut [i32; PART]) {
    let groups = usize::min(rows.len() / PAIRS, inputs.len());
    // SAFETY: all groups of rows, of which there are two halves, and of inputs are there, and the sums may be written; the
    // feature says that the processor has the instructions.
    unsafe { add_all(sums, columns(rows, half), inputs.as_ptr(), groups) };
}

/// As [`super::sums::of_listed`].
#[allow(unsafe_code)]
#[inline(always)]
pub(super) fn of_listed(
    rows: &[[Part; 2]],
    half: usize,
    list: &List,
    sums: &mut [i32; PART],
) -> Option<()> {
    let pairs = list.pairs();
    rows.get(pairs.last().map_or(0, |last| last.row as usize))?;
    // SAFETY: rows of a list rise, and all up to the last one are there, behind whose pairs stands one of zeros, and the sums may be
    // written; the feature says that the processor has the instructions.
    unsafe { add_listed(sums, columns(rows, half), pairs.as_ptr()) };
    Some(())
}

/// Where one of the halves of the first row starts.
#[inline(always)]
fn columns(rows: &[[Part; 2]], half: usize) -> *const Part {
    rows.as_ptr().cast::<Part>().wrapping_add(half & 1)
}

/// As [`super::sums::dot`], of vectors of the same whole multiple of eight integers that start at words, as those of an arena do;
/// of others 0.
#[allow(unsafe_code)]
#[inline(always)]
pub(super) fn dot(vector: &[i16], row: &[i16]) -> i32 {
    let eights = usize::min(vector.len(), row.len()) / 8;
    if !are_words(vector.as_ptr().addr() | row.as_ptr().addr()) {
        return 0;
    }
    // SAFETY: both have so many, and start at words; the feature says that the processor has the instructions.
    unsafe { add_dot(vector.as_ptr(), row.as_ptr(), eights) }
}

/// Whether integers at an address may be read two by two, or at several addresses that are joined bit by bit.
#[inline(always)]
fn are_words(addresses: usize) -> bool {
    addresses.is_multiple_of(4)
}

/// As [`super::sums::mix`].
#[allow(unsafe_code)]
#[inline(always)]
pub(super) fn mix(weights: &[i16], rows: IntegerRows<'_>, sums: &mut [i32]) {
    let ends = |slot: &u16| (usize::from(*slot) + 1).saturating_mul(rows.width);
    let most = rows.slots.iter().map(ends).fold(0, usize::max);
    let parts = sums.len().min(rows.width) / PART;
    let are_there = most <= rows.integers.len() && weights.len() >= rows.slots.len();
    let are_words = are_words(rows.integers.as_ptr().addr() | 2 * rows.width);
    if !are_there || !are_words || rows.slots.is_empty() {
        sums.fill(0);
        return;
    }
    let mut columns = Mixed {
        columns: rows.integers.as_ptr(),
        stride: 2 * rows.width,
        end: rows.slots.as_ptr_range().end,
    };
    for sums in sums.as_chunks_mut::<PART>().0.iter_mut().take(parts) {
        // SAFETY: every row has these columns and starts at a word, every slot has a weight, and there is a slot; the feature
        // says that the processor has the instructions.
        unsafe { add_rows(sums, weights.as_ptr(), rows.slots.as_ptr(), &columns) };
        columns.columns = columns.columns.wrapping_add(PART);
    }
}

/// Eight columns of rows that are mixed.
#[repr(C)]
struct Mixed {
    /// Those of the first row.
    columns: *const i16,
    /// Bytes from a row to the next.
    stride: usize,
    /// Where slots end.
    end: *const u16,
}

/// Multiplies the pair in r0 with two columns, whose weights are a word in a register, and adds to two sums.
macro_rules! two_columns {
    ($word:literal, $even:literal, $odd:literal) => {
        concat!(
            "sxtb16 lr, ",
            $word,
            "\n",
            "sxtb16 ",
            $word,
            ", ",
            $word,
            ", ror #8\n",
            "smlad ",
            $even,
            ", lr, r0, ",
            $even,
            "\n",
            "smlad ",
            $odd,
            ", ",
            $word,
            ", r0, ",
            $odd,
            "\n",
        )
    };
}

/// Eight sums of nothing.
macro_rules! zero_sums {
    () => {
        "mov r4, #0\nmov r5, #0\nmov r6, #0\nmov r7, #0\nmov r8, #0\nmov r9, #0\nmov r10, #0\nmov r11, #0\n"
    };
}

/// Four words in a row of weights at r1, with the pair at r2 unless that is zero.
macro_rules! row {
    ($first:literal, $third:literal) => {
        concat!(
            "ldr r0, [r2], #4\n",
            "cbz r0, 2f\n",
            "ldrd r3, r12, [r1, #",
            $first,
            "]\n",
            two_columns!("r3", "r4", "r5"),
            two_columns!("r12", "r6", "r7"),
            "ldrd r3, r12, [r1, #",
            $third,
            "]\n",
            two_columns!("r3", "r8", "r9"),
            two_columns!("r12", "r10", "r11"),
            "2:\n",
        )
    };
}

/// The sums of eight columns, of the products of whole groups of pairs of inputs, whose weights stand in every second half of
/// a row.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn add_all(
    sums: &mut [i32; PART],
    columns: *const Part,
    inputs: *const Inputs,
    groups: usize,
) {
    naked_asm!(
        "push {{r0, r3, r4-r11, lr}}",
        zero_sums!(),
        "cmp r3, #0",
        "beq 3f",
        "1:",
        row!("0", "8"),
        row!("32", "40"),
        row!("64", "72"),
        row!("96", "104"),
        "adds r1, #128",
        "ldr r0, [sp, #4]",
        "subs r0, #1",
        "str r0, [sp, #4]",
        "bne 1b",
        "3:",
        "ldr r0, [sp]",
        "stm r0, {{r4-r11}}",
        "add sp, #8",
        "pop {{r4-r11, pc}}",
    )
}

/// The same for listed pairs: each names its row, counted from that of `columns` on. The first that is zero ends the list.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn add_listed(sums: &mut [i32; PART], columns: *const Part, list: *const Listed) {
    naked_asm!(
        "push {{r0, r4-r11, lr}}",
        zero_sums!(),
        "1:",
        "ldrd r3, r0, [r2], #8",
        "cbz r0, 3f",
        "add r3, r1, r3, lsl #5",
        "ldr r12, [r3]",
        two_columns!("r12", "r4", "r5"),
        "ldr r12, [r3, #4]",
        two_columns!("r12", "r6", "r7"),
        "ldr r12, [r3, #8]",
        two_columns!("r12", "r8", "r9"),
        "ldr r12, [r3, #12]",
        two_columns!("r12", "r10", "r11"),
        "b 1b",
        "3:",
        "pop {{r0}}",
        "stm r0, {{r4-r11}}",
        "pop {{r4-r11, pc}}",
    )
}

/// The dot product of two vectors of so many times eight integers.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn add_dot(vector: *const i16, row: *const i16, eights: usize) -> i32 {
    naked_asm!(
        "push {{r4-r11, lr}}",
        "mov r3, #0",
        "cbz r2, 2f",
        "1:",
        "ldmia r0!, {{r4-r7}}",
        "ldmia r1!, {{r8-r11}}",
        "smlad r3, r4, r8, r3",
        "smlad r3, r5, r9, r3",
        "smlad r3, r6, r10, r3",
        "smlad r3, r7, r11, r3",
        "subs r2, #1",
        "bne 1b",
        "2:",
        "mov r0, r3",
        "pop {{r4-r11, pc}}",
    )
}

/// The sums of eight columns of rows, each row times its weight; at least one.
#[allow(unsafe_code)]
#[unsafe(naked)]
unsafe extern "C" fn add_rows(
    sums: &mut [i32; PART],
    weights: *const i16,
    slots: *const u16,
    columns: &Mixed,
) {
    naked_asm!(
        "push {{r0, r4-r11, lr}}",
        "ldm r3, {{r4-r6}}",
        "push {{r4-r6}}",
        "mov r0, r2",
        zero_sums!(),
        "1:",
        "ldrd r2, r3, [sp]",
        "ldrh r12, [r0], #2",
        "mla r2, r12, r3, r2",
        "ldrsh r3, [r1], #2",
        "ldrd r12, lr, [r2]",
        "smlabb r4, r12, r3, r4",
        "smlatb r5, r12, r3, r5",
        "smlabb r6, lr, r3, r6",
        "smlatb r7, lr, r3, r7",
        "ldrd r12, lr, [r2, #8]",
        "smlabb r8, r12, r3, r8",
        "smlatb r9, r12, r3, r9",
        "smlabb r10, lr, r3, r10",
        "smlatb r11, lr, r3, r11",
        "ldr r12, [sp, #8]",
        "cmp r0, r12",
        "bne 1b",
        "add sp, #12",
        "pop {{r0}}",
        "stm r0, {{r4-r11}}",
        "pop {{r4-r11, pc}}",
    )
}
