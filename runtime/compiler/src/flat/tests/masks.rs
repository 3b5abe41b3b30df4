//! Scores of what must not be chosen, which are minus infinity in many files and no number in a plan.

use sortie_core::plan::AlignedBytes;
use sortie_plans::{FlatPolicy, PlanFlatPolicy};
use tract_onnx::pb::tensor_proto::DataType::{Bool, Float};

use super::files::File;
use super::plans::{compiled, number};

#[test]
fn closed_actions_have_the_lowest_score() {
    let masked = || {
        File::default().input("obs", Float, &["1", "4"]).input("mask", Float, &["1", "3"]).layer(
            "obs",
            [4, 3],
            "open",
        )
    };
    let chosen = |closed: f32| {
        masked()
            .constant("closed", &[], &[closed])
            .node_with("Cast", &["mask"], "flags", vec![number("to", Bool as i64)])
            .node("Where", &["flags", "open", "closed"], "scores")
    };
    let files = [
        ("minus infinity", chosen(f32::NEG_INFINITY).node("Identity", &["scores"], "logits")),
        ("its log-softmax", chosen(f32::NEG_INFINITY).node("LogSoftmax", &["scores"], "logits")),
        (
            "the logarithm of a softmax",
            chosen(-1.0e8).node("Softmax", &["scores"], "shares").node(
                "Log",
                &["shares"],
                "logits",
            ),
        ),
        (
            "the logarithm of the mask",
            masked().node("Log", &["mask"], "log").node("Add", &["open", "log"], "logits"),
        ),
    ];
    for (what, file) in files {
        let policy = compiled(&file.output("logits")).unwrap_or_else(|e| panic!("{what}: {e}"));
        let bytes = AlignedBytes::copy_of(&policy.compiled.bytes);
        let mut plan = PlanFlatPolicy::load(bytes.as_slice(), policy.facts).expect("a plan");
        let inputs: [&[f32]; 2] = [&[0.3, -0.2, 0.1, 0.5], &[1.0, 0.0, 1.0]];
        let answer = plan.run(&inputs, &mut []).expect("an answer");
        let scores = &answer[0].numbers;
        assert_eq!(scores[1], f32::MIN, "{what}");
        assert!(scores[0] > -10.0 && scores[2] > -10.0, "{what}: {scores:?}");
    }
}

#[test]
fn the_logarithm_of_a_softmax_has_no_lower_end() {
    let file = File::default()
        .input("obs", Float, &["1", "2"])
        .node("Softmax", &["obs"], "shares")
        .node("Log", &["shares"], "action")
        .output("action");
    let policy = compiled(&file).expect("a plan");
    let bytes = AlignedBytes::copy_of(&policy.compiled.bytes);
    let mut plan = PlanFlatPolicy::load(bytes.as_slice(), policy.facts).expect("a plan");
    for x in [-80.0, -90.0, -100.0, -103.9] {
        let answer = plan.run(&[&[0.0, x]], &mut []).expect("an answer");
        assert_eq!(answer[0].numbers, [0.0, x]);
    }
    assert!(plan.run(&[&[0.0, -104.5]], &mut []).is_err(), "32 bits hold no such share");
}
