//! Plans of other networks than the file's: whatever a lowering could get wrong is refused, and rounding is not.

use sortie_core::plan::AlignedBytes;
use sortie_plans::{CompileError, CompileOptions, PlanFlatPolicy, PolicyOptions, ProofCase};
use tract_onnx::pb::tensor_proto::DataType::Float;
use tract_onnx::pb::{AttributeProto, GraphProto, TensorProto};

use super::files::File;
use super::plans::{compiled, float, number};
use crate::compile::prove_policy;
use crate::flat::FlatGraph;
use crate::networks::TruePolicy;

/// Weights around zero, other ones for every seed.
fn weights(count: usize, seed: u64) -> Vec<f32> {
    let scale = 2.0 / (count as f32).sqrt().sqrt();
    let number = |at: u64| {
        let mixed = (at + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ seed.wrapping_mul(0xBF58_476D);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed >> 40) as f32 / 16_777_216.0 - 0.5) * scale
    };
    (0..count as u64).map(number).collect()
}

/// A normaliser, three layers with a norm between them, and a GRU behind a softmax.
fn network() -> File {
    let dense = |file: File, from: &str, [rows, columns]: [usize; 2], to: &str| {
        let (weight, bias) = (format!("{to}.w"), format!("{to}.b"));
        let file = file.constant(&weight, &[rows, columns], &weights(rows * columns, rows as u64));
        let file = file.constant(&bias, &[columns], &weights(columns, 7));
        file.node("Gemm", &[from, &weight, &bias], to)
    };
    let mut file = File::default()
        .input("x", Float, &["1", "16"])
        .constant("mean", &[16], &weights(16, 3))
        .constant(
            "deviation",
            &[16],
            &weights(16, 4).iter().map(|x| 0.5 + x.abs()).collect::<Vec<_>>(),
        )
        .node("Sub", &["x", "mean"], "shifted")
        .node("Div", &["shifted", "deviation"], "seen");
    file = dense(file, "seen", [16, 24], "first");
    file = file.node_with("Elu", &["first"], "bent", vec![float("alpha", 1.0)]);
    file = file.constant("scale", &[24], &weights(24, 5)).constant("shift", &[24], &weights(24, 6));
    let norm = vec![float("epsilon", 1.0e-3), number("axis", -1)];
    file = file.nodes("LayerNormalization", &["bent", "scale", "shift"], &["norm"], norm);
    file = dense(file, "norm", [24, 24], "second");
    file = file.node("Tanh", &["second"], "third");
    file = file
        .constant("W", &[1, 36, 24], &weights(36 * 24, 8))
        .constant("R", &[1, 36, 12], &weights(36 * 12, 9))
        .constant("B", &[1, 72], &weights(72, 10))
        .whole("row", &[0])
        .node("Unsqueeze", &["third", "row"], "history")
        .input("h_in", Float, &["1", "1", "12"])
        .nodes(
            "GRU",
            &["history", "W", "R", "B", "", "h_in"],
            &["all", "h_out"],
            vec![number("hidden_size", 12), number("linear_before_reset", 1)],
        )
        .whole("flat", &[1, 12])
        .node("Reshape", &["h_out", "flat"], "state");
    dense(file, "state", [12, 5], "q").output("q").output("h_out")
}

/// A change of a network.
type Fault = Box<dyn Fn(&mut GraphProto)>;

/// Judges the plan of a network with a fault by the network without.
fn judged(fault: impl Fn(&mut GraphProto)) -> Result<(), CompileError> {
    let mut wrong = network();
    fault(&mut wrong.0);
    judged_by(&network(), &wrong, &[])
}

/// Judges a network's plan by another network, on recorded inputs too.
fn judged_by(right: &File, plan_of: &File, recorded: &[ProofCase]) -> Result<(), CompileError> {
    let policy = compiled(plan_of).expect("a network");
    let bytes = AlignedBytes::copy_of(&policy.compiled.bytes);
    let mut plan = PlanFlatPolicy::load(bytes.as_slice(), policy.facts.clone()).expect("a plan");
    let graph = FlatGraph::read(&right.bytes(), &PolicyOptions::default()).expect("a file");
    let mut truth = TruePolicy::open(graph).expect("a truth");
    prove_policy(&mut plan, &mut truth, &CompileOptions::default(), recorded).map(|_| ())
}

fn tensor<'a>(graph: &'a mut GraphProto, name: &str) -> &'a mut TensorProto {
    graph.initializer.iter_mut().find(|tensor| tensor.name == name).expect("is stored")
}

fn change(name: &'static str, change: fn(&mut [f32])) -> impl Fn(&mut GraphProto) {
    move |graph| change(&mut tensor(graph, name).float_data)
}

fn attribute(operator: &'static str, attribute: AttributeProto) -> impl Fn(&mut GraphProto) {
    move |graph| {
        let node = graph.node.iter_mut().find(|node| node.op_type == operator).expect("is there");
        node.attribute.retain(|other| other.name != attribute.name);
        node.attribute.push(attribute.clone());
    }
}

/// A number as 16 bits with eight of exponent hold it.
fn brain(x: &mut f32) {
    *x = f32::from_bits((x.to_bits() + 0x8000) & 0xffff_0000);
}

#[test]
fn what_a_lowering_could_get_wrong_is_refused() {
    let faults: Vec<(&str, Fault)> = vec![
        ("a matrix in 16 bits", Box::new(change("second.w", |w| w.iter_mut().for_each(brain)))),
        ("neighbours exchanged", Box::new(change("second.w", |w| w.swap(100, 101)))),
        (
            "a row's sign",
            Box::new(change("first.w", |w| w[..24].iter_mut().for_each(|x| *x = -*x))),
        ),
        ("no bias", Box::new(change("q.b", |b| b.fill(0.0)))),
        ("a bias too large by a thousandth", Box::new(change("first.b", |b| b[3] *= 1.001))),
        (
            "epsilon in the deviation",
            Box::new(change("deviation", |d| d.iter_mut().for_each(|x| *x += 1.0e-4))),
        ),
        ("another epsilon", Box::new(attribute("LayerNormalization", float("epsilon", 1.0e-5)))),
        ("another alpha", Box::new(attribute("Elu", float("alpha", 1.05)))),
        (
            "the reset gate before the product",
            Box::new(attribute("GRU", number("linear_before_reset", 0))),
        ),
        ("gates exchanged", Box::new(change("W", |w| w[..24 * 24].rotate_left(12 * 24)))),
        (
            "a matrix turned",
            Box::new(change("second.w", |w| {
                for (row, column) in
                    (0..24).flat_map(|row| (0..row).map(move |column| (row, column)))
                {
                    w.swap(row * 24 + column, column * 24 + row);
                }
            })),
        ),
        ("a last column dropped", Box::new(change("q.w", |w| w[55..].fill(0.0)))),
    ];
    for (name, fault) in faults {
        let found = judged(fault);
        assert!(matches!(found, Err(CompileError::Wrong { .. })), "{name}: {found:?}");
    }
}

#[test]
fn equal_rows_that_round_alike_are_no_fault() {
    // 64 equal columns err alike, so that their sum errs 64 times as much as one of them.
    let file = File::default()
        .input("x", Float, &["1", "64"])
        .layer("x", [64, 64], "same")
        .node("Tanh", &["same"], "bent")
        .layer("bent", [64, 3], "q")
        .output("q");
    assert!(compiled(&file).is_ok(), "{:?}", compiled(&file).err());
    judged(|_| ()).expect("the network is its own");
}

#[test]
fn what_only_recorded_inputs_reach_is_refused_on_these() {
    let clipped = |limit: f32| {
        let file = File::default()
            .input("x", Float, &["1", "4"])
            .constant("low", &[], &[-limit])
            .constant("high", &[], &[limit])
            .node("Clip", &["x", "low", "high"], "seen")
            .constant("q.w", &[4, 2], &weights(8, 1))
            .constant("q.b", &[2], &weights(2, 2));
        file.node("Gemm", &["seen", "q.w", "q.b"], "q").output("q")
    };
    let recorded = |x: f32| ProofCase { inputs: vec![vec![x; 4]], states: None };
    let judge = |cases: &[ProofCase]| judged_by(&clipped(50.0), &clipped(90.0), cases);
    judge(&[]).expect("no random input reaches the limit");
    judge(&[recorded(40.0)]).expect("nor does this one");
    let found = judge(&[recorded(40.0), recorded(80.0)]);
    assert!(matches!(found, Err(CompileError::Wrong { .. })), "{found:?}");
    let found = judged_by(&clipped(5.0), &clipped(9.0), &[]);
    assert!(
        matches!(found, Err(CompileError::Wrong { .. })),
        "far inputs reach this one: {found:?}"
    );
}

#[test]
fn scores_that_are_shut_hide_no_fault_of_those_that_are_open() {
    for low in [-1.0e8, f32::MIN] {
        let masked = |bias: f32| {
            let file = File::default()
                .input("x", Float, &["1", "6"])
                .input("mask", Float, &["1", "4"])
                .constant("w", &[6, 4], &weights(24, 1))
                .constant("b", &[4], &[0.1, 0.2, bias, 0.4])
                .constant("one", &[], &[1.0])
                .constant("low", &[], &[low])
                .node("Gemm", &["x", "w", "b"], "scores")
                .node("Sub", &["one", "mask"], "shut")
                .node("Mul", &["shut", "low"], "lower");
            file.node("Add", &["scores", "lower"], "logits").output("logits")
        };
        let found = judged_by(&masked(0.3), &masked(0.301), &[]);
        assert!(matches!(found, Err(CompileError::Wrong { .. })), "{low}: {found:?}");
    }
}

#[test]
fn recorded_states_are_those_of_the_proof() {
    // The state only counts where it is beyond what is fed back: 1 at most.
    let kept = |limit: f32| {
        let file = File::default()
            .input("x", Float, &["1", "3"])
            .input("h_in", Float, &["1", "3"])
            .constant("low", &[], &[-limit])
            .constant("high", &[], &[limit])
            .node("Clip", &["h_in", "low", "high"], "kept")
            .node("Add", &["x", "kept"], "sum")
            .node("Tanh", &["sum"], "h_out")
            .layer("h_out", [3, 2], "q");
        file.output("q").output("h_out")
    };
    let recorded = |h: f32| ProofCase { inputs: vec![vec![0.1; 3]], states: Some(vec![h; 3]) };
    let judge = |cases: &[ProofCase]| judged_by(&kept(1.2), &kept(1.5), cases);
    judge(&[recorded(0.9)]).expect("no state reaches the limit");
    let found = judge(&[recorded(1.4)]);
    assert!(matches!(found, Err(CompileError::Wrong { .. })), "{found:?}");
}

#[test]
fn a_narrow_normaliser_hides_no_fault() {
    // Inputs of size 1 drive every answer to an end of its range, where nothing shows.
    let narrow = |deviation: f32| {
        let file = File::default()
            .input("x", Float, &["1", "8"])
            .constant("mean", &[8], &[3.0; 8])
            .constant("deviation", &[8], &[deviation; 8])
            .node("Sub", &["x", "mean"], "shifted")
            .node("Div", &["shifted", "deviation"], "seen")
            .constant("q.w", &[8, 3], &weights(24, 5))
            .constant("q.b", &[3], &weights(3, 6))
            .node("Gemm", &["seen", "q.w", "q.b"], "sum");
        file.node("Tanh", &["sum"], "q").output("q")
    };
    let found = judged_by(&narrow(1.0e-3), &narrow(1.01e-3), &[]);
    assert!(matches!(found, Err(CompileError::Wrong { .. })), "{found:?}");
}
