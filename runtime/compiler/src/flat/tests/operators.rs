//! Every operator by its defaults, at arguments near and far, beside what onnxruntime answers.

use std::fs;

use safetensors::SafeTensors;
use sortie_core::plan::AlignedBytes;
use sortie_plans::{CompileOptions, FlatPolicy, PlanFlatPolicy, PolicyOptions};

use crate::compile_policy;

fn floats(answers: &SafeTensors<'_>, name: &str) -> Vec<f32> {
    let bytes = answers.tensor(name).expect("is recorded").data();
    let number = |four: &[u8]| f32::from_le_bytes(four.try_into().expect("four bytes"));
    bytes.chunks_exact(4).map(number).collect()
}

/// Compiles every output of a file by itself, and compares its plan with what was recorded.
fn judge(name: &str) {
    let path = format!("{}/../../tests/golden/operators/{name}", env!("CARGO_MANIFEST_DIR"));
    let file = fs::read(format!("{path}.onnx")).expect("a file");
    let bytes = fs::read(format!("{path}.safetensors")).expect("answers");
    let answers = SafeTensors::deserialize(&bytes).expect("tensors");
    let mut wrong = Vec::new();
    let outputs = answers.names();
    let outputs = outputs.iter().filter_map(|name| name.strip_prefix("out__"));
    for output in outputs {
        let policy =
            PolicyOptions { outputs: vec![format!("{output}:continuous")], ..Default::default() };
        let compiled = match compile_policy(&file, &policy, &CompileOptions::default()) {
            Ok(compiled) => compiled,
            Err(error) => {
                wrong.push(format!("{output}: {error}"));
                continue;
            }
        };
        let plan = AlignedBytes::copy_of(&compiled.compiled.bytes);
        let mut plan =
            PlanFlatPolicy::load(plan.as_slice(), compiled.facts.clone()).expect("a plan");
        let given: Vec<Vec<f32>> = compiled
            .facts
            .given()
            .map(|input| floats(&answers, &format!("in__{}", input.name)))
            .collect();
        let given: Vec<&[f32]> = given.iter().map(Vec::as_slice).collect();
        let want = floats(&answers, &format!("out__{output}"));
        let got = match plan.run(&given, &mut []) {
            Ok(got) => got[0].numbers.clone(),
            Err(error) => {
                wrong.push(format!("{output}: {error}"));
                continue;
            }
        };
        for (at, (got, want)) in got.iter().zip(&want).enumerate() {
            let is_near = (got - want).abs() <= 2.0e-6 * want.abs() + 1.0e-7;
            if !is_near {
                wrong.push(format!("{output} at {at}: {got:e} instead of {want:e}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn functions_are_onnxruntimes_at_any_argument() {
    judge("functions");
}

#[test]
fn defaults_are_those_of_the_specification() {
    judge("rows");
}
