//! A tape that has been through its largest pass allocates nothing of its own.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use sortie_nn::gradient_check::random;
use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};
use sortie_nn::layers::{SparseRows, VisibleLists};
use sortie_nn::random::stream;
use sortie_nn::tape::{Gru, Linear, Parameters, Tape};

/// Counts what the calling thread allocates.
struct Counting;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: everything is done by the system's allocator.
#[expect(unsafe_code, reason = "an allocator is unsafe to implement")]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller's promise is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is the same.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

fn allocations(work: impl FnOnce()) -> usize {
    let before = COUNT.get();
    work();
    COUNT.get() - before
}

const WIDTH: usize = 8;
const ROWS: usize = 6;

struct Network {
    first: Linear,
    keys_values: Linear,
    memory: Gru,
    head: Linear,
}

fn pass(
    tape: &mut Tape,
    parameters: &Parameters,
    network: &Network,
    (rows, visible): (&SparseRows, &VisibleLists),
    (memory, gradient): (&mut [f32], &mut [f32]),
) {
    let mut t = tape.begin(&parameters.values);
    let x = t.sparse_linear(rows, network.first);
    let x = t.relu(x);
    let keys_values = t.linear(x, network.keys_values);
    let looked = t.attention(x, keys_values, visible, 2);
    let remembered = t.gru(looked, network.memory, &[true; ROWS], memory);
    let both = t.concat(&[looked, remembered]);
    let y = t.linear_rectified(both, network.head);
    let y = t.softmax(y);
    let y = t.softmax_by(y, &[0, 0, 1, 1, 1, 2], 3);
    let y = t.elu(y);
    let chosen = t.pick(y, &[0, 1, 2, 0, 1, 2]);
    let loss = t.huber(chosen, &[0.5; ROWS], 1.0, 0.1);
    t.backward(loss, gradient);
}

/// How many times the kernels of products allocate in one pass: so often as the same products alone.
fn products(network: &Network) -> usize {
    let (a, b) = (random(1, 4096), random(2, 4096));
    let mut out = vec![0.0; 4096];
    let mut product = |rows: usize, columns: usize, inner: usize, (left, right): (bool, bool)| {
        let turned = |data, rows, columns, turn: bool| match turn {
            true => Matrix::new(data, columns, rows).transposed(),
            false => Matrix::new(data, rows, columns),
        };
        let (left, right) = (turned(&a, rows, inner, left), turned(&b, inner, columns, right));
        multiply(MatrixMut::new(&mut out, rows, columns), Store::Replace, left, right);
    };
    let mut layer = |rows: usize, input: usize, output: usize, forward: usize| {
        (0..forward).for_each(|_| product(rows, output, input, (false, true)));
        (0..forward).for_each(|_| product(rows, input, output, (false, false)));
        product(output, input, rows, (true, false));
    };
    allocations(|| {
        for linear in [network.keys_values, network.head] {
            layer(ROWS, linear.shape.input, linear.shape.output, 1);
        }
        layer(ROWS, WIDTH, 3 * WIDTH, 1);
        layer(ROWS / 2, WIDTH, 3 * WIDTH, 2);
        // The gradient of the memory's weights is one product over all steps, as long as that of the input's.
    })
}

#[test]
fn a_warm_tape_allocates_what_its_products_do() {
    let random = &mut stream(1, 1, 0);
    let mut parameters = Parameters::default();
    let network = Network {
        first: parameters.sparse_linear("first", [4, WIDTH], 2.0, random),
        keys_values: parameters.projection("keys_values", WIDTH, 2 * WIDTH, random),
        memory: parameters.gru("memory", WIDTH, random),
        head: parameters.linear("head", 2 * WIDTH, 3, random),
    };
    let (mut rows, mut visible) = (SparseRows::default(), VisibleLists::default());
    for row in 0..ROWS {
        rows.push(row % 4, 1.0);
        rows.end_row();
        (0..=row).for_each(|row| visible.push(row));
        visible.end_list();
    }
    let mut gradient = vec![0.0; parameters.values.len()];
    let mut memory = [0.0; 3 * WIDTH];
    let mut tape = Tape::default();
    let mut again = || {
        let slopes = (&mut memory[..], &mut gradient[..]);
        allocations(|| pass(&mut tape, &parameters, &network, (&rows, &visible), slopes))
    };
    let first = again();
    let warm = again();
    assert_eq!(warm, again());
    assert!(warm < first, "{warm} after {first}");
    assert_eq!(warm, products(&network));
}
