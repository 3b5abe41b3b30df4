//! The published low level against the reference's modules and one step of its learner.

use serde_json::Value;
use sortie_learn::random::{Purpose, generator};
use sortie_nn::layers::gru::{GruPass, GruShape};
use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::softmax;
use sortie_nn::optimise::RmsProp;
use sortie_nn::tape::{Parameters, Places, Tape};

use super::assert_close;
use super::files::{Case, json_cases, json_file, safetensors_case};
use super::{reference, windows};
use crate::alma::agents::Conditioning;
use crate::alma::teams::Agents;
use crate::alma::windows::PopArt;
use crate::alma::windows::low_level::tests::{agent_utilities, team_input, team_values};
use crate::alma::windows::low_level::{
    HypernetworkLayers, HypernetworkShape, LowLevel, LowLevelConfig, Mixer, MixerShape, Mode,
    Nonnegative, PopArtOrder,
};

/// The cases of a file with their switches.
fn configured(group: &str) -> Vec<(Value, Case)> {
    let file = json_file(group);
    let cases = file["cases"].as_array().expect("cases").iter();
    cases.map(|case| case["config"].clone()).zip(json_cases(group)).collect()
}

fn nonnegative(softmax: bool) -> Nonnegative {
    if softmax { Nonnegative::Softmax } else { Nonnegative::Absolute }
}

fn hypernetwork_shape(case: &Case, prefix: &str) -> HypernetworkShape {
    let sizes = |name: &str| &case.get(&format!("{prefix}{name}")).shape;
    let fc1 = sizes("fc1.weight");
    HypernetworkShape { input: fc1[1], width: fc1[0], heads: 4, mixing: sizes("fc2.weight")[0] }
}

/// All modes but the vector of agents, which only the linear mixer asks for.
#[test]
fn hypernetworks_agree() {
    let mut modes = Vec::new();
    for (config, case) in configured("hypernet") {
        let mode = match config["mode"].as_str() {
            Some("matrix") => Mode::Matrix,
            Some("vector") => Mode::Vector,
            Some("scalar") => Mode::Scalar,
            _ => continue,
        };
        modes.push(mode);
        let per_task = config["per_task"].as_bool().expect("a switch");
        let agents = config["n_agents"].as_u64().expect("agents") as usize;
        let states = reference::states(&case, agents, 0);
        let conditioning = if per_task { Conditioning::Mask } else { Conditioning::None };
        let (input, rows) = team_input(&states, conditioning);
        let shape = hypernetwork_shape(&case, "w/");
        let parameters = reference::hypernetwork(&case, "w/");
        let random = &mut generator(1, Purpose::Weights, 0);
        let sizes = (shape, mode);
        let layers = HypernetworkLayers::new("w1", sizes, &mut Parameters::default(), random);
        let mut tape = Tape::default();
        let mut pass = tape.begin(&parameters);
        let merged = layers.merged(&mut pass);
        let with_merged = [&*parameters, pass.values(merged)].concat();
        let mut pass = tape.begin(&with_merged);
        let merged = &mut Places { end: parameters.len() };
        let numbers = layers.numbers(&mut pass, merged, (&input, agents));
        let width = shape.mixing;
        let mut numbers = pass.values(numbers).to_vec();
        if config["nonneg"] == "softmax" {
            // That of scalars was taken over the whole batch, which no network does.
            let row = if mode == Mode::Scalar { numbers.len() } else { width };
            numbers.chunks_mut(row).for_each(softmax::forward);
        } else {
            numbers.iter_mut().for_each(|number| *number = number.abs());
        }
        let want = &case.get("out/out").data;
        if mode != Mode::Matrix {
            assert_close(&case.name, &numbers, want);
            continue;
        }
        let tasks = if per_task { states.shape.tasks } else { 1 };
        let mut compared = 0;
        for (row, (state, agent)) in numbers.chunks(width).zip(rows) {
            let task = match states.entity_task[state * states.shape.entities + agent] {
                task if per_task => usize::from(task),
                _ => 0,
            };
            let at = ((state * tasks + task) * agents + agent) * width;
            assert_close(&case.name, row, &want[at..at + width]);
            compared += 1;
        }
        assert!(compared > 10, "{}: too few agents", case.name);
    }
    assert!([Mode::Matrix, Mode::Vector, Mode::Scalar].iter().all(|mode| modes.contains(mode)));
}

fn check_mixer(case: &Case, conditioning: Conditioning, softmax_weights: bool) {
    let shape = &case.get("in/agent_qs").shape;
    let agents = shape[shape.len() - 1];
    let states = reference::states(case, agents, 0);
    let outputs = if conditioning.has_subtasks() { states.shape.tasks } else { 1 };
    let shape = MixerShape {
        hypernetwork: hypernetwork_shape(case, "w/V."),
        slots: agents,
        outputs,
        nonnegative: nonnegative(softmax_weights),
        bias_nonnegative: true,
    };
    let mut drawn = Parameters::default();
    let mixer = Mixer::new(shape, &mut drawn, &mut generator(1, Purpose::Weights, 0));
    let parameters = reference::mixer(case, "w/", outputs);
    assert_eq!(parameters.len(), drawn.values.len(), "as many as the shape has");
    let utilities = case.get("in/agent_qs").f32s();
    let values = team_values(mixer, &parameters, &states, conditioning, &utilities);
    assert_close(&case.name, &values, &case.get("out/q_tot").data);
}

/// Values of teams of the agents alone; imagined teams are not mixed here.
#[test]
fn mixers_agree() {
    for (group, conditioning) in [
        ("mixer_alma_none", Conditioning::None),
        ("mixer_alma_mask", Conditioning::Mask),
        ("mixer_alma_full_obs", Conditioning::Input),
    ] {
        for (config, case) in configured(group) {
            assert_eq!(config["imagine"], false);
            let softmax = config["softmax_mixing_weights"].as_bool().expect("a switch");
            check_mixer(&case, conditioning, softmax);
        }
    }
}

#[test]
fn a_mixer_at_save_the_city_sizes_agrees() {
    check_mixer(&safetensors_case("networks", "mixer_default"), Conditioning::Mask, true);
}

#[test]
fn agents_that_see_everything_agree() {
    for case in json_cases("agent_ff_full_obs") {
        let want = case.get("out/q");
        let [.., agents, actions] = want.shape[..] else { panic!("sizes") };
        let network = reference::agents(&case, "w/", 4);
        let states = reference::states(&case, agents, actions);
        let order = reference::order(&case);
        let agents = Agents::new(network.view());
        let utilities = agent_utilities(agents, &states, Conditioning::Input, &order);
        assert_close(&case.name, &utilities, &want.data);
    }
}

#[test]
fn a_memory_that_is_emptied_agrees() {
    for case in json_cases("gru_head_reset") {
        let hidden = case.get("out/hidden_per_step_before_reset");
        let [batches, steps, slots, width] = hidden.shape[..] else { panic!("sizes") };
        let names = ["rnn.weight_ih", "rnn.weight_hh", "rnn.bias_ih", "rnn.bias_hh"];
        let tensor = |name: &str| case.get(&format!("w/{name}")).f32s();
        let parameters: Vec<f32> = names.into_iter().flat_map(tensor).collect();
        let (input, mut memory) = (case.get("in/x").f32s(), case.get("in/hidden0").f32s());
        let reset = &case.get("in/reset").data;
        let (wide, actions) = (slots * width, case.get("out/q").shape[3]);
        for batch in 0..batches {
            let place = batch * steps * wide..(batch + 1) * steps * wide;
            let flags = &reset[batch * steps..(batch + 1) * steps];
            let carry = flags.iter().flat_map(|reset| vec![*reset == 0.0; slots]);
            let carry: Vec<bool> = carry.collect();
            let mut output = vec![0.0; steps * wide];
            GruPass::default().forward(
                GruShape { width, slots },
                &parameters,
                (&input[place.clone()], &carry),
                &mut memory[batch * wide..][..wide],
                &mut output,
            );
            assert_close(&case.name, &output, &hidden.data[place]);
            let mut utilities = vec![0.0; steps * slots * actions];
            let head = LinearShape { input: width, output: actions };
            let (weight, bias) = (tensor("fc_out.weight"), tensor("fc_out.bias"));
            linear::forward(head, &output, &weight, &bias, &mut utilities);
            let place = batch * utilities.len()..(batch + 1) * utilities.len();
            assert_close(&case.name, &utilities, &case.get("out/q").data[place]);
        }
    }
}

/// A learner as the reference's, with its recorded weights.
fn learner(case: &Case, conditioning: Conditioning) -> LowLevel {
    let sizes = windows::windows(case).shape;
    let config = LowLevelConfig {
        conditioning,
        width: 16,
        base: 8,
        hypernetwork_width: 16,
        mixing: 8,
        bias_nonnegative: true,
        popart_per_task: true,
        popart_order: PopArtOrder::Reference,
        ..LowLevelConfig::default()
    };
    let mut learner = LowLevel::new(config, sizes, &mut generator(1, Purpose::Weights, 0));
    learner.online.values.copy_from_slice(&recorded(case, "w/"));
    learner.target.copy_from_slice(&recorded(case, "target_w/"));
    learner.popart = PopArt { mean: 0.25, variance: 2.25, started: true };
    learner.target_popart = learner.popart;
    learner
}

/// Recorded tensors of all parameters in the order of a learner's gradient.
fn recorded(case: &Case, prefix: &str) -> Vec<f32> {
    let agents = reference::agents(case, &format!("{prefix}agent."), 4);
    let mixer = reference::mixer(case, &format!("{prefix}mixer."), 0);
    agents.parameters.iter().copied().chain(mixer).collect()
}

fn assert_near(what: &str, got: f64, want: f64, tolerance: f64) {
    assert!((got - want).abs() <= tolerance, "{what}: {got} against {want}");
}

/// Descends the loss of a recorded batch, and compares what is learned: targets, where they are, and the statistics that
/// follow them. Loss and norm of the gradient come with the learner.
fn check_targets(case: &Case, conditioning: Conditioning) -> (LowLevel, [f64; 2]) {
    let windows = windows::windows(case);
    let mut learner = learner(case, conditioning);
    let report = learner.descend(&windows, 1, &mut generator(1, Purpose::Replay, 0));

    let steps = windows.shape.steps;
    let columns = case.get("out/targets").shape[2];
    let place =
        |state: usize, task: usize| (state / steps * (steps - 1) + state % steps) * columns + task;
    let mut mask = vec![0.0; case.get("out/td_mask").data.len()];
    for term in learner.terms() {
        let at = place(term.state, term.task);
        mask[at] = 1.0;
        assert_near("target", term.target, case.get("out/targets").data[at], 1e-5);
        let normalised = learner.popart.normalise(term.target);
        assert_near("normalised", normalised, case.get("out/targets_normalised").data[at], 1e-5);
    }
    assert_eq!(mask, case.get("out/td_mask").data, "{}: mask", case.name);
    let popart = learner.popart;
    assert_near("mean", popart.mean, case.get("out/popart_mean").data[0], 1e-6);
    assert_near("variance", popart.variance, case.get("out/popart_var").data[0], 1e-6);
    (learner, [report.loss, report.gradient_norm.into()])
}

fn check_step(name: &str, conditioning: Conditioning) {
    let case = safetensors_case("learner", name);
    let (mut learner, [loss, norm]) = check_targets(&case, conditioning);
    assert_near("loss", loss, case.get("out/stat/losses.q_loss").data[0], 1e-5);
    assert_near("norm", norm, case.get("out/stat/train_metrics.q_grad_norm").data[0], 1e-5);

    let want = recorded(&case, "out/grad/");
    assert_eq!(learner.gradient.len(), want.len());
    for (index, (got, want)) in learner.gradient.iter().zip(&want).enumerate() {
        let tolerance = 1e-6 + 1e-3 * want.abs();
        assert!((got - want).abs() <= tolerance, "{name}: gradient {index}: {got} against {want}");
    }
    learner.follow();
    let got = learner.online.values.iter();
    let mut compared = 0;
    for ((got, after), slope) in got.zip(recorded(&case, "out/after/")).zip(want) {
        // The first step of RMSprop is nearly the sign of the slope, which is noise where it is tiny.
        if slope.abs() >= 1e-9 {
            assert_near(name, f64::from(*got), f64::from(after), 1e-5);
            compared += 1;
        }
    }
    assert!(compared > 1000, "{name}: too few parameters moved");
}

#[test]
fn a_step_with_subtasks_agrees() {
    check_step("low_alma_mask_0", Conditioning::Mask);
}

#[test]
fn a_step_without_subtasks_agrees() {
    check_step("low_flat_0", Conditioning::None);
}

/// A learner that imagines besides, which none here does, has the same targets; half of its loss is of what is seen.
#[test]
fn targets_beside_imagined_ones_agree() {
    let case = safetensors_case("learner", "low_alma_mask_refil_0");
    let (_, [loss, _]) = check_targets(&case, Conditioning::Mask);
    let recorded = |name: &str| case.get(&format!("out/stat/losses.{name}")).data[0];
    assert_near("loss", 0.5 * loss + 0.5 * recorded("im_loss"), recorded("q_loss"), 1e-5);
}

/// The optimiser alone, on the recorded gradients. PopArt has rescaled its head before.
#[test]
fn optimiser_agrees_on_recorded_gradients() {
    for name in ["low_alma_mask_0", "low_flat_0"] {
        let case = safetensors_case("learner", name);
        let mut parameters = recorded(&case, "w/");
        let (gradient, want) = (recorded(&case, "out/grad/"), recorded(&case, "out/after/"));
        RmsProp::new(parameters.len()).step(&mut parameters, &gradient, 5e-4);
        let heads = 2 * case.get("w/mixer.popart_weight").data.len();
        let compared = parameters.len() - heads;
        for (got, want) in parameters.iter().zip(&want).take(compared) {
            assert_near(name, f64::from(*got), f64::from(*want), 1e-5);
        }
    }
}
