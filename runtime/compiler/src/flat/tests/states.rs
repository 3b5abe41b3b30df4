//! Which inputs are recurrent states.

use sortie_plans::ValueType;

use crate::flat::selection::{Pair, find, refuse_hidden};
use crate::flat::values::{Value, Values};

fn floats(name: &str, shape: &[usize]) -> Value {
    Value {
        name: name.to_owned(),
        kind: Some(ValueType::F32),
        shape: Some(shape.to_vec()),
        is_flag: false,
    }
}

/// The pairs among floats of these names, all of one shape, as `IN:OUT`.
fn pairs(inputs: &[&str], outputs: &[&str], asked: &[&str]) -> Result<Vec<String>, String> {
    let of = |names: &[&str]| names.iter().map(|name| floats(name, &[1, 4])).collect();
    let values = Values { inputs: of(inputs), outputs: of(outputs) };
    let asked: Vec<String> = asked.iter().map(ToString::to_string).collect();
    let pairs = find(&values, &asked).map_err(|error| error.to_string())?;
    Ok(pairs.iter().map(|Pair { input, output }| format!("{input}:{output}")).collect())
}

#[test]
fn names_that_producers_give_states_are_paired() {
    let known: [(&[&str], &[&str]); 16] = [
        (&["h_in"], &["h_out"]),
        (&["h_in", "c_in"], &["c_out", "h_out"]),
        (&["state_ins"], &["state_outs"]),
        (&["hidden"], &["next_hidden"]),
        (&["h"], &["h1"]),
        (&["h", "c"], &["h1", "c1"]),
        (&["h0", "c0"], &["hn", "cn"]),
        (&["hx", "cx"], &["hy", "cy"]),
        (&["h0", "h1"], &["h0_out", "h1_out"]),
        (&["state_in_0", "state_in_1"], &["state_out_0", "state_out_1"]),
        (&["hiddenIn"], &["hiddenOut"]),
        (&["rnn_states"], &["rnn_state.1"]),
        (&["hidden_state"], &["h"]),
        (&["state_in"], &["gru"]),
        (&["history"], &["new_history"]),
        (&["obs_history_in"], &["obs_history_out"]),
    ];
    for (inputs, outputs) in known {
        let with_others: Vec<&str> = ["obs"].iter().chain(inputs).copied().collect();
        let outputs: Vec<&str> = ["actions"].iter().chain(outputs).copied().collect();
        let found = pairs(&with_others, &outputs, &[]).unwrap();
        let found_inputs: Vec<&str> =
            found.iter().filter_map(|pair| pair.split(':').next()).collect();
        assert_eq!(found_inputs, inputs, "{found:?}");
        let crossed = found.iter().any(|pair| pair.contains("h") && pair.contains("c"));
        assert!(!crossed || inputs[0].contains("hidden"), "{found:?}");
    }
}

#[test]
fn other_names_are_no_states() {
    for (input, output) in [
        ("obs", "obs_out"),
        ("in", "out"),
        ("x", "x1"),
        ("state", "value"),
        ("height", "height_out"),
    ] {
        assert_eq!(pairs(&[input], &[output], &[]).unwrap(), [""; 0], "{input}");
    }
}

#[test]
fn a_state_comes_back_in_its_own_shape_and_type() {
    let mut values =
        Values { inputs: vec![floats("h", &[1, 4])], outputs: vec![floats("h_out", &[1, 5])] };
    assert_eq!(find(&values, &[]).unwrap(), []);
    values.outputs[0].shape = None;
    assert_eq!(find(&values, &[]).unwrap().len(), 1, "nobody knows its shape yet");
    values.outputs[0].kind = Some(ValueType::I64);
    assert_eq!(find(&values, &[]).unwrap(), []);
}

#[test]
fn several_ways_to_come_back_are_listed_with_the_flag() {
    let message = pairs(&["h"], &["h1", "h2"], &[]).unwrap_err();
    for word in ["`h` f32 [1, 4]", "`h1`", "`h2`", "--state IN:OUT"] {
        assert!(message.contains(word), "{word}: {message}");
    }
    assert!(pairs(&["h1", "h2"], &["h_out"], &[]).is_err(), "one output cannot be both");
}

#[test]
fn what_is_asked_for_counts_and_nothing_else() {
    assert_eq!(pairs(&["h", "a:b"], &["h1", "c:d"], &["a:b:c:d"]).unwrap(), ["a:b:c:d"]);
    assert_eq!(pairs(&["h"], &["h1"], &["none"]).unwrap(), [""; 0]);
    let message = pairs(&["h"], &["h1"], &["h:x"]).unwrap_err();
    assert!(message.contains("`h:x`") && message.contains("`h1`"), "{message}");
}

#[test]
fn an_input_that_only_its_shape_tells_is_refused_with_the_flag() {
    let (obs, memory) = (floats("obs", &[1, 8]), floats("x2", &[1, 4]));
    let (other, value) = (floats("y2", &[1, 4]), floats("value", &[1, 1]));
    let message = refuse_hidden(&[&obs, &memory], &[&other, &value]).unwrap_err().to_string();
    for word in ["`x2`", "`y2`", "--state IN:OUT", "--state none"] {
        assert!(message.contains(word), "{word}: {message}");
    }
    assert!(refuse_hidden(&[&obs, &memory], &[&value]).is_ok());
    assert!(refuse_hidden(&[&memory], &[&other]).is_ok(), "the only floats are the observation");
}
