//! Networks over all entities become plans that answer as their graphs do.

use sortie_compiler::compile;
use sortie_core::EntityMask;
use sortie_core::internal::ops::OpRef;
use sortie_core::operators::OpKind;
use sortie_core::plan::{AlignedBytes, Network, Plan};
use sortie_plans::{
    CompileError, CompileOptions, Compiled, NetworkInput, OwnedEntities, random_entities,
};

use crate::support::beside_truth;

const FILES: [(&str, &[u8], [usize; 4]); 2] = [
    // Width, outputs, groups, operators.
    ("small", include_bytes!("../../../../tests/golden/onnx/entities_small.onnx"), [16, 1, 3, 9]),
    ("odd", include_bytes!("../../../../tests/golden/onnx/entities_odd_sizes.onnx"), [15, 4, 5, 9]),
];
const FEATURES: usize = 7;
const N_MAX: usize = 9;

fn compiled(onnx: &[u8]) -> Compiled {
    compile(onnx, &CompileOptions { n_max: N_MAX, ..CompileOptions::default() }).unwrap()
}

/// What the plan answers: values, attended rows, sums by group.
fn ask(plan: &[u8], step: &OwnedEntities) -> Vec<Vec<f32>> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let widths: Vec<usize> = plan.program().outputs().map(|o| o.width as usize).collect();
    let groups = FILES.iter().find(|(_, _, sizes)| sizes[0] == widths[2]).unwrap().2[2];
    let rows = [1, step.groups.len(), groups];
    let mut answers: Vec<Vec<f32>> =
        rows.iter().zip(&widths).map(|(rows, width)| vec![f32::NAN; rows * width]).collect();
    let mut outputs: Vec<&mut [f32]> = answers.iter_mut().map(Vec::as_mut_slice).collect();
    plan.evaluate(arena.as_mut_slice(), &step.view(), &mut outputs).unwrap();
    answers
}

#[test]
fn all_operators_are_recognised() {
    for (name, onnx, [width, outputs, groups, operators]) in FILES {
        let Compiled { bytes, report } = compiled(onnx);
        assert!(report.inputs == 256, "{name}: {report:?}");
        let plan = AlignedBytes::copy_of(&bytes);
        let plan = Plan::load(plan.as_slice()).unwrap();
        assert_eq!(plan.header().network, Network::Entities);
        let kinds: Vec<OpKind> = plan.program().ops().map(OpRef::kind).collect();
        assert_eq!(kinds.len(), operators, "{kinds:?}");
        for kind in [OpKind::AttendAll, OpKind::MeanRows, OpKind::GroupSum] {
            assert_eq!(kinds.iter().filter(|found| **found == kind).count(), 1, "{kinds:?}");
        }
        let widths: Vec<usize> = plan.program().outputs().map(|o| o.width as usize).collect();
        assert_eq!(widths, [outputs, width, width]);
        assert_eq!(ask(&bytes, &random_entities(1, N_MAX, FEATURES, groups, 1)[0]).len(), 3);
    }
}

#[test]
fn plan_and_graph_agree_on_random_and_adversarial_entities() {
    for (name, onnx, [_, _, groups, _]) in FILES {
        let plan = compiled(onnx).bytes;
        let base = || random_entities(40, N_MAX, FEATURES, groups, 3);
        let scaled = |factor: f32| {
            let mut steps = base();
            steps.iter_mut().flat_map(|step| &mut step.rows).for_each(|value| *value *= factor);
            steps
        };
        let with = |change: &dyn Fn(&mut OwnedEntities)| {
            let mut steps = base();
            steps.iter_mut().for_each(change);
            steps
        };
        let families = [
            ("random", random_entities(200, N_MAX, FEATURES, groups, 2)),
            ("one entity", random_entities(50, 1, FEATURES, groups, 4)),
            ("nobody present", with(&|step| step.present = EntityMask::EMPTY)),
            ("all present", with(&|step| step.present = EntityMask::first(step.groups.len()))),
            ("no agent", with(&|step| step.agents = EntityMask::EMPTY)),
            ("no groups", with(&|step| step.groups.fill(0))),
            ("in every group", with(&|step| step.groups.fill(u32::MAX))),
            ("denormals", scaled(1.0e-40)),
            ("values of 1e6", scaled(1.0e6)),
        ];
        for (family, steps) in families {
            let count = steps.len();
            let inputs = steps.into_iter().map(NetworkInput::Entities);
            let found = beside_truth(&plan, onnx, inputs);
            assert!(found.agrees(), "{name}, {family}: {found:?}");
            assert_eq!(found.inputs, count);
        }
    }
}

#[test]
fn what_absent_entities_hold_never_matters() {
    for (_, onnx, [_, _, groups, _]) in FILES {
        let plan = compiled(onnx).bytes;
        for step in random_entities(100, N_MAX, FEATURES, groups, 5) {
            let mut poisoned = step.clone();
            for (entity, row) in poisoned.rows.chunks_mut(FEATURES).enumerate() {
                if !step.present.contains(entity) {
                    row.fill(f32::NAN);
                }
            }
            assert_eq!(ask(&plan, &step), ask(&plan, &poisoned));
        }
    }
}

#[test]
fn another_form_is_named_with_node_operator_and_shapes() {
    let (_, onnx, _) = FILES[0];
    let renamed = |from: &[u8], to: &[u8]| {
        let mut onnx = onnx.to_vec();
        let at = onnx.windows(from.len()).position(|bytes| bytes == from).unwrap();
        onnx[at..at + to.len()].copy_from_slice(to);
        compile(&onnx, &CompileOptions::default()).map(|_| ()).unwrap_err()
    };
    // The mean divided by the smaller of count and one; the sum of agents that are present or not.
    let cases = [(&b"\x22\x03Max"[..], &b"\x22\x03Min"[..]), (b"\x22\x03And", b"\x22\x03Xor")];
    for (from, to) in cases {
        let error = renamed(from, to);
        let CompileError::Unsupported { operator, shapes, hint, .. } = &error else {
            panic!("{error:?}");
        };
        assert!(!operator.is_empty() && shapes.contains("f32 [") && !hint.is_empty(), "{error}");
    }
}
