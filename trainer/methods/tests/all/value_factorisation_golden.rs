//! Value factorisation against the reference's modules, on recorded inputs (`tests/golden`).

use sortie_envs::{EntitySet, Observation};
use sortie_methods::value_factorisation::{AgentPass, AgentShape, Partitions, Scenes};

use crate::files::{Case, json_cases};

/// The entities that a row of a mask leaves open.
fn open(mask: &[f64]) -> EntitySet {
    mask.iter().enumerate().map(|(at, masked)| EntitySet::from(*masked == 0.0) << at).sum()
}

/// Rows of a tensor.
fn rows<'a>(case: &'a Case, name: &str, width: usize) -> Vec<&'a [f64]> {
    case.get(name).data.chunks(width).collect()
}

#[test]
fn imagined_masks_are_the_recorded_ones() {
    for case in json_cases("imagined_masks") {
        let (observed, present) = (rows(&case, "in/obs_mask", 6), rows(&case, "in/entity_mask", 6));
        for (trajectory, part) in rows(&case, "in/partition_groupA", 6).into_iter().enumerate() {
            let part = !open(part);
            for step in 0..3 {
                let state = 3 * trajectory + step;
                // As recorded, who is there at first counts.
                let there = open(present[3 * trajectory]);
                for entity in (0..6).filter(|entity| there >> entity & 1 == 1) {
                    let within = Partitions::Drawn.within(part, 0, entity) & there;
                    let at = 6 * state + entity;
                    let seen = open(observed[at]);
                    let want = |name: &str| open(rows(&case, name, 6)[at]);
                    let name = format!("{}, state {state}, entity {entity}", case.name);
                    assert_eq!(seen & within, want("out/within_obs_mask"), "{name}");
                    assert_eq!(seen & !within, want("out/interact_obs_mask"), "{name}");
                    assert_eq!(there & within, want("out/within_mixer_mask"), "{name}");
                    assert_eq!(there & !within, want("out/interact_mixer_mask"), "{name}");
                }
            }
        }
    }
}

/// With a head that hands on what stands before it, utilities are what the recorded network has behind
/// its attention, rectified.
#[test]
fn agents_look_as_the_recorded_ones_do() {
    for case in json_cases("agent_ff_none") {
        let (input, width) = (9, 16);
        let shape =
            AgentShape { input, active_inputs: 9, width, actions: width, skip: false, memory: 0 };
        let weights = |name: &str| case.get(&format!("w/_base.{name}")).f32s();
        let fc1 = weights("fc1.weight");
        let mut parameters: Vec<f32> =
            (0..input * width).map(|at| fc1[at % width * input + at / width]).collect();
        parameters.extend(weights("fc1.bias"));
        parameters.extend(weights("attn.in_trans.weight"));
        parameters.extend(weights("attn.out_trans.weight"));
        parameters.extend(weights("attn.out_trans.bias"));
        let unit = |at: usize| f32::from(u8::from(at / width == at % width));
        parameters.extend((0..width * width).map(unit));
        parameters.extend([0.0; 16]);

        let mut scenes = Scenes::default();
        let entities = case.get("in/entities").f32s();
        let (observed, absent) = (rows(&case, "in/obs_mask", 6), rows(&case, "in/entity_mask", 6));
        let mut want: Vec<f64> = Vec::new();
        for state in 0..9 {
            let present = open(absent[state]);
            let mut seen = Observation { present, entities: present, ..Observation::default() };
            for entity in (0..6).filter(|entity| present >> entity & 1 == 1) {
                seen.rows.push_dense(&entities[(6 * state + entity) * input..][..input]);
            }
            seen.observable = (0..3).map(|agent| open(observed[6 * state + agent])).collect();
            seen.available = vec![1; 3];
            scenes.push(&seen, |_| EntitySet::MAX);
            for agent in (0..3).filter(|agent| present >> agent & 1 == 1) {
                want.extend(rows(&case, "out/attn_out", width)[3 * state + agent]);
            }
        }
        scenes.finish();
        let mut pass = AgentPass::default();
        let got = pass.forward(shape, &parameters, &scenes, 1);
        assert_eq!(got.len(), want.len());
        for (got, want) in got.iter().zip(want) {
            let want = want.max(0.0);
            assert!((f64::from(*got) - want).abs() <= 1e-5 * (1.0 + want), "{got} and {want}");
        }
    }
}
