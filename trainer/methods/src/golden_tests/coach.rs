//! COPA's coach and recognition network against the reference's modules.

use crate::alma::agents::UtilityInput;
use crate::alma::coach::{CoachLayers, CoachShape, RecognitionLayers};
use crate::alma::windows::low_level::coaching::state_input;
use sortie_learn::random::{Purpose, generator};
use sortie_nn::tape::{Parameters, Tape};

use super::assert_close;
use super::files::{Case, json_cases};
use super::reference;

/// The columns of all matrices `[out, in]`, one matrix behind the other: rows `[in, out]` of one layer.
pub(super) fn columns<N: AsRef<str>>(case: &Case, names: &[N]) -> Vec<f32> {
    let mut rows = Vec::new();
    for name in names {
        let tensor = case.get(name.as_ref());
        let (outputs, inputs) = (tensor.shape[0], tensor.shape[1]);
        for column in 0..inputs {
            rows.extend((0..outputs).map(|row| tensor.data[row * inputs + column] as f32));
        }
    }
    rows
}

fn parameters(case: &Case, first: &[&str], rest: &[&str]) -> Vec<f32> {
    let mut parameters = columns(case, first);
    rest.iter().for_each(|name| parameters.extend(case.get(name).f32s()));
    parameters
}

#[test]
fn coach_and_recognition_agree() {
    for case in json_cases("copa") {
        let [samples, agents, actions] = case.get("in/actions_onehot").shape[..] else {
            panic!("sizes")
        };
        let mut windows = reference::states(&case, agents, 0);
        let taken = case.get("in/actions_onehot").data.chunks(actions);
        let taken = taken.map(|row| row.iter().position(|v| *v == 1.0).unwrap_or(0) as u8);
        windows.actions = taken.collect();
        let order = reference::order(&case);
        let encode = case.get("w/coach.entity_encode.weight");
        let strategy = case.get("w/coach.mean.bias").data.len();
        let shape = CoachShape {
            features: encode.shape[1],
            marks: windows.shape.tasks,
            width: encode.shape[0],
            heads: 4,
            strategy,
        };
        let states: Vec<usize> = (0..samples).collect();
        let present: Vec<usize> = (0..samples * agents)
            .filter(|at| windows.present[at / agents * windows.shape.entities + at % agents])
            .collect();
        assert!((10..samples * agents).contains(&present.len()), "{}", case.name);
        let check = |name: &str, rows: &[f32]| {
            let all = &case.get(name).data;
            let want = present.iter().flat_map(|at| &all[at * strategy..][..strategy]);
            assert_close(
                &format!("{} {name}", case.name),
                rows,
                &want.copied().collect::<Vec<_>>(),
            );
        };
        let coach = parameters(
            &case,
            &["w/coach.entity_encode.weight", "w/coach.task_embed.fc.weight"],
            &[
                "w/coach.entity_encode.bias",
                "w/coach.mha.in_trans.weight",
                "w/coach.mha.out_trans.weight",
                "w/coach.mha.out_trans.bias",
                "w/coach.mean.weight",
                "w/coach.logvar.weight",
                "w/coach.mean.bias",
                "w/coach.logvar.bias",
            ],
        );
        let (mut drawn, random) = (Parameters::default(), &mut generator(1, Purpose::Weights, 0));
        let layers = CoachLayers::new(shape, &mut drawn, random);
        assert_eq!(coach.len(), drawn.values.len());
        let mut input = UtilityInput::default();
        state_input(shape, &windows, &states, &order, false, &mut input);
        let mut tape = Tape::default();
        let mut pass = tape.begin(&coach);
        let told = layers.strategies(&mut pass, &input);
        check("out/mu", pass.values(told.means));
        check("out/logvar", pass.values(told.log_variances));
        let noise = case.get("in/eps").f32s();
        let noise = present.iter().flat_map(|at| &noise[at * strategy..][..strategy]).copied();
        let drawn = told.draw(&mut pass, &noise.collect::<Vec<_>>());
        check("out/z", pass.values(drawn));

        let recognition = parameters(
            &case,
            &[
                "w/recog.entity_encode.weight",
                "w/recog.task_embed.fc.weight",
                "w/recog.action_embedding.weight",
            ],
            &[
                "w/recog.entity_encode.bias",
                "w/recog.mha.in_trans.weight",
                "w/recog.mha.out_trans.weight",
                "w/recog.mha.out_trans.bias",
                "w/recog.mean.0.weight",
                "w/recog.logvar.0.weight",
                "w/recog.mean.0.bias",
                "w/recog.logvar.0.bias",
                "w/recog.mean.2.weight",
                "w/recog.logvar.2.weight",
                "w/recog.mean.2.bias",
                "w/recog.logvar.2.bias",
            ],
        );
        let mut drawn = Parameters::default();
        let layers = RecognitionLayers::new(shape, actions, &mut drawn, random);
        assert_eq!(recognition.len(), drawn.values.len());
        state_input(shape, &windows, &states, &order, true, &mut input);
        let mut pass = tape.begin(&recognition);
        let guess = layers.guess(&mut pass, &input);
        check("out/recog_mean", pass.values(guess.means));
        check("out/recog_logvar", pass.values(guess.log_variances));
    }
}
