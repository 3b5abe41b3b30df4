//! PopArt's statistics and its rescaled head against the reference's.

use crate::alma::windows::PopArt;

use super::files::{Tensor, json_file, json_tensor};

#[test]
fn popart_agrees() {
    let file = json_file("popart");
    for case in file["cases"].as_array().expect("cases") {
        // A case whose outputs have statistics of their own holds several PopArts.
        let outputs = case["config"]["n_out"].as_u64().expect("outputs") as usize;
        let shared = case["config"]["shared_stats_over_outputs"].as_bool().expect("a switch");
        let groups = if shared { 1 } else { outputs };
        let mut popart = vec![PopArt::default(); groups];
        let (mut weights, mut biases) = (vec![1.0_f32; outputs], vec![0.0_f32; outputs]);
        for step in case["steps"].as_array().expect("steps") {
            let tensor = |name: &str| json_tensor(&step[name]);
            let (targets, mask) = (tensor("targets"), tensor("mask"));
            for (group, popart) in popart.iter_mut().enumerate() {
                let own = targets.data.iter().zip(&mask.data).enumerate();
                let own = own.filter(|(index, _)| index % groups == group);
                let own = own.map(|(_, (target, mask))| (*target, *mask));
                let outputs = if shared { 0..outputs } else { group..group + 1 };
                let mut head = [&weights[outputs.clone()], &biases[outputs.clone()]].concat();
                popart.update(own, &mut head);
                let (own_weights, own_biases) = head.split_at(outputs.len());
                weights[outputs.clone()].copy_from_slice(own_weights);
                biases[outputs].copy_from_slice(own_biases);
            }
            let of = |index: usize| &popart[index % groups];
            let normalised = targets.data.iter().enumerate();
            let normalised: Vec<f64> = normalised.map(|(i, y)| of(i).normalise(*y)).collect();
            let close = |name: &str, got: &[f64]| assert_near(&tensor(name), got);
            close("normalised", &normalised);
            close("mean_after", &(0..outputs).map(|i| of(i).mean).collect::<Vec<_>>());
            close("var_after", &(0..outputs).map(|i| of(i).variance).collect::<Vec<_>>());
            let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
            close("weight_after", &wide(&weights));
            close("bias_after", &wide(&biases));
        }
    }
}

fn assert_near(want: &Tensor, got: &[f64]) {
    assert_eq!(want.data.len(), got.len());
    for (want, got) in want.data.iter().zip(got) {
        assert!((want - got).abs() < 1e-6 * (1.0 + want.abs()), "{got} against {want}");
    }
}
