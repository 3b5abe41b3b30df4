//! Whole files: sizes, what is cut away, what inputs are for.

use sortie_plans::{InputRole, OutputRole, PolicyFacts, PolicyOptions};
use tract_onnx::pb;
use tract_onnx::pb::tensor_proto::DataType::{Bool, Float, Int64, Uint8};

use super::files::File;
use crate::flat::nodes::Nodes;
use crate::flat::{FlatGraph, remarks};

fn named(facts: &PolicyFacts, role: InputRole) -> Vec<&str> {
    let inputs = facts.inputs.iter().filter(|input| input.role == role);
    inputs.map(|input| input.name.as_str()).collect()
}

/// A policy of one layer.
fn plain() -> File {
    File::default().input("obs", Float, &["1", "4"]).layer("obs", [4, 3], "q").output("q")
}

fn with_states(states: &[&str]) -> PolicyOptions {
    let states = states.iter().map(ToString::to_string).collect();
    PolicyOptions { states, ..PolicyOptions::default() }
}

#[test]
fn a_batch_is_one_wherever_it_stands() {
    let file = File::default()
        .input("obs", Float, &["B", "4"])
        .input("h", Float, &["1", "B", "4"])
        .node("Add", &["obs", "h"], "h_out")
        .layer("h_out", [4, 3], "q")
        .output("q")
        .output("h_out");
    let facts = file.found();
    assert_eq!(facts.inputs[0].shape, [1, 4]);
    assert_eq!(facts.states[0].length, 4);
    let sizes = vec![("B".to_owned(), 2)];
    let facts = file.read(&PolicyOptions { sizes, ..PolicyOptions::default() }).unwrap();
    assert_eq!(facts.inputs[1].shape, [1, 2, 4]);
}

#[test]
fn a_batch_that_the_file_fixes_is_remarked_on_and_may_be_one() {
    let mut file = File::default().input("obs", Float, &["8", "4"]).layer("obs", [4, 3], "q");
    file.0.output = File::default().input("q", Float, &["8", "3"]).0.input;
    let read = |options: &PolicyOptions| FlatGraph::read(&file.bytes(), options).expect("a policy");
    let said = remarks(&read(&PolicyOptions::default()));
    assert!(said.len() == 1 && said[0].contains("`--size obs.0=1`"), "{said:?}");
    let sizes = vec![("obs.0".to_owned(), 1)];
    let graph = read(&PolicyOptions { sizes, ..PolicyOptions::default() });
    assert_eq!(remarks(&graph), Vec::<String>::new());
    let facts = graph.interface.facts;
    assert_eq!(
        (&facts.inputs[0].shape[..], &facts.outputs[0].shape[..]),
        (&[1, 4][..], &[1, 3][..])
    );
}

#[test]
fn a_size_that_may_be_no_batch_is_remarked_on() {
    let remarked = |size: &str, options: &PolicyOptions| {
        let file = File::default().input("moves", Float, &[size, "4"]).layer("moves", [4, 1], "q");
        remarks(&FlatGraph::read(&file.output("q").bytes(), options).expect("a policy"))
    };
    let none = PolicyOptions::default();
    for batch in ["batch", "batch_size", "N", "unk__12", "s77", "num_envs", "obs_dim_0", "1", "?"] {
        assert_eq!(remarked(batch, &none), Vec::<String>::new(), "{batch}");
    }
    let said = remarked("n_moves", &none);
    assert!(said.len() == 1 && said[0].contains("`--size n_moves=7`"), "{said:?}");
    let sizes = vec![("n_moves".to_owned(), 5)];
    let asked = remarked("n_moves", &PolicyOptions { sizes, ..PolicyOptions::default() });
    assert!(!asked.iter().any(|remark| remark.contains("batch of one")), "{asked:?}");
}

#[test]
fn a_size_that_is_left_open_is_named_with_its_flag() {
    let file = |size: &str| {
        let file = File::default().input("obs", Float, &["1", size]);
        file.node("Relu", &["obs"], "q").output("q")
    };
    for (size, name) in [("N", "N"), ("?", "obs.1"), ("0", "obs.1"), ("-1", "obs.1")] {
        let message = file(size).refused();
        assert!(message.contains(&format!("`--size {name}=7`")), "{message}");
        let sizes = vec![(name.to_owned(), 7)];
        let facts = file(size).read(&PolicyOptions { sizes, ..PolicyOptions::default() });
        assert_eq!(facts.unwrap().inputs[0].shape, [1, 7]);
    }
    let sizes = vec![("M".to_owned(), 7)];
    let message = file("N").read(&PolicyOptions { sizes, ..PolicyOptions::default() });
    let message = message.unwrap_err().to_string();
    assert!(message.contains("`M`") && message.contains("`N`"), "{message}");
}

#[test]
fn only_what_the_wanted_output_needs_is_read() {
    let file = plain()
        .input("goal", Float, &["1", "2"])
        .layer("goal", [2, 2], "value")
        .node("NoSuchOperator", &["value"], "strange")
        .output("strange");
    let facts = file.found();
    assert_eq!(facts.inputs.len(), 1);
    assert_eq!((facts.parameters, facts.multiply_adds), (12, Some(12)));
    let outputs = vec!["strange".to_owned()];
    let other = file.read(&PolicyOptions { outputs, ..PolicyOptions::default() });
    assert!(other.is_err(), "nobody knows that operator");
}

#[test]
fn what_a_graph_inside_a_node_reads_is_needed() {
    let inner = plain().node("Add", &["q", "outside"], "sum").output("sum").0;
    let attribute = pb::AttributeProto { g: Some(inner), ..Default::default() };
    let mut file = plain().node("Relu", &["obs"], "outside").node("If", &["obs"], "chosen");
    file.0.node[2].attribute.push(attribute);
    let nodes = Nodes::of(&file.0);
    assert!(nodes.behind(["chosen"]).contains("outside"));
    assert!(!nodes.behind(["q"]).contains("outside"));
}

#[test]
fn states_come_with_what_needs_them_and_only_then() {
    let file = || {
        File::default()
            .input("obs", Float, &["1", "4"])
            .input("h_in", Float, &["1", "4"])
            .node("Identity", &["h_in"], "h_out")
            .layer("obs", [4, 3], "q")
            .output("q")
            .output("h_out")
    };
    let facts = file().found();
    assert_eq!((facts.inputs.len(), facts.states.len()), (1, 0), "nobody reads this state");
    // One state needs another.
    let file = File::default()
        .input("obs", Float, &["1", "4"])
        .input("c_in", Float, &["1", "4"])
        .input("h_in", Float, &["1", "4"])
        .node("Add", &["obs", "h_in"], "q")
        .node("Add", &["h_in", "c_in"], "h_out")
        .node("Relu", &["c_in"], "c_out")
        .output("h_out")
        .output("q")
        .output("c_out");
    let facts = file.found();
    let outputs: Vec<&str> = facts.outputs.iter().map(|output| output.name.as_str()).collect();
    assert_eq!(outputs, ["q", "c_out", "h_out"]);
    assert_eq!(named(&facts, InputRole::State), ["c_in", "h_in"]);
    assert_eq!(named(&facts, InputRole::Observation), ["obs"]);
    let facts = file.read(&with_states(&["none"])).unwrap();
    assert_eq!(named(&facts, InputRole::Observation), ["obs", "h_in"]);
}

#[test]
fn a_state_of_another_length_is_refused() {
    let file = File::default()
        .input("obs", Float, &["1", "4"])
        .input("h", Float, &["1", "2"])
        .layer("h", [2, 4], "wide")
        .node("Add", &["obs", "wide"], "q")
        .output("q")
        .output("wide");
    let message = file.read(&with_states(&["h:wide"])).unwrap_err().to_string();
    assert!(message.contains("`h`") && message.contains("`wide`"), "{message}");
}

#[test]
fn a_mask_as_long_as_there_are_actions_says_which_are_available() {
    let masked = |size: &str| {
        File::default()
            .input("obs", Float, &["1", "3"])
            .input("legal", Bool, &["1", size])
            .input("task", Int64, &["1", "3"])
            .node("Where", &["legal", "obs", "obs"], "masked")
            .node("Cast", &["task"], "ignored")
            .node("Add", &["masked", "obs"], "scores")
            .argmax("scores", "place")
            .node("Identity", &["place"], "choice")
            .choice("choice")
    };
    let facts = masked("3").found();
    assert_eq!(named(&facts, InputRole::Available), ["legal"]);
    assert_eq!(facts.outputs[0].role.to_string(), "action, discrete 3");
    assert_eq!(named(&masked("1").found(), InputRole::Extra), ["legal"]);
}

#[test]
fn two_masks_are_listed_with_the_flag() {
    let mut file = File::default()
        .input("obs", Float, &["1", "3"])
        .input("legal", Bool, &["1", "3"])
        .input("pad", Uint8, &["1", "3"])
        .node("Where", &["legal", "obs", "obs"], "masked")
        .node("Cast", &["pad"], "padding")
        .node("Where", &["legal", "masked", "obs"], "q")
        .output("q");
    let to_bool =
        pb::AttributeProto { name: "to".into(), i: Bool as i64, r#type: 2, ..Default::default() };
    file.0.node[1].attribute.push(to_bool);
    file.0.node[2].input[0] = "padding".to_owned();
    let message = file.refused();
    for word in ["`legal` bool [1, 3]", "`pad` u8 [1, 3]", "--available NAME"] {
        assert!(message.contains(word), "{word}: {message}");
    }
    let asked = |name: &str| {
        file.read(&PolicyOptions { available: Some(name.to_owned()), ..PolicyOptions::default() })
    };
    let facts = asked("pad").unwrap();
    assert_eq!(named(&facts, InputRole::Available), ["pad"]);
    assert_eq!(named(&facts, InputRole::Extra), ["legal"]);
    assert_eq!(named(&asked("none").unwrap(), InputRole::Extra), ["legal", "pad"]);
    assert!(asked("obs").unwrap_err().to_string().contains("`obs`"));
}

#[test]
fn whole_numbers_are_observations_without_floats_and_strange_numbers_are_refused() {
    let file =
        File::default().input("task", Int64, &["1", "3"]).node("Relu", &["task"], "q").output("q");
    assert_eq!(named(&file.found(), InputRole::Observation), ["task"]);
    let file = File::default()
        .input("obs", pb::tensor_proto::DataType::Int16, &["1", "3"])
        .node("Relu", &["obs"], "q")
        .output("q");
    assert!(file.refused().contains("one of f32, f64"), "{}", file.refused());
}

#[test]
fn broken_files_are_refused() {
    let circle = File::default()
        .input("obs", Float, &["1", "3"])
        .node("Add", &["obs", "q"], "x")
        .node("Relu", &["x"], "q")
        .output("q");
    assert!(circle.read(&PolicyOptions::default()).is_err());
    let carried = plain().node("Identity", &["a"], "b").node("Identity", &["b"], "a").choice("a");
    assert!(Nodes::of(&carried.0).argmax("a").is_none());
    let huge = File::default().input("obs", Float, &["4294967296", "4294967296"]);
    let huge = huge.node("Relu", &["obs"], "q").output("q");
    assert!(huge.refused().contains("more than"), "{}", huge.refused());
    let mut no_output = plain();
    no_output.0.output.clear();
    assert!(no_output.refused().contains("no output"));
    let mut no_type = plain();
    no_type.0.input[0].r#type = None;
    assert!(no_type.refused().contains("`obs` has no sizes"));
    let bytes = plain().bytes();
    for length in (0..bytes.len()).step_by(7) {
        assert!(crate::flat::FlatGraph::read(&bytes[..length], &PolicyOptions::default()).is_err());
    }
}

#[test]
fn the_likeliest_stands_for_what_is_drawn() {
    let drawn = || {
        plain()
            .node_with("Softmax", &["q"], "probabilities", vec![])
            .node("Log", &["probabilities"], "logarithms")
            .node("Multinomial", &["logarithms"], "several")
            .node("RandomNormalLike", &["q"], "noise")
            .node("Add", &["q", "noise"], "normal")
            .node("RandomUniformLike", &["q"], "even")
    };
    for (output, operator) in
        [("several", "Multinomial"), ("normal", "RandomNormalLike"), ("even", "RandomUniformLike")]
    {
        let mut file = drawn();
        file.0.output.clear();
        let message = file.output(output).refused();
        let flag = format!("`--output {output}:likeliest`");
        assert!(message.contains(operator) && message.contains(&flag), "{message}");
        let mut file = drawn();
        file.0.output.clear();
        let outputs = vec![format!("{output}:likeliest")];
        let facts =
            file.output(output).read(&PolicyOptions { outputs, ..PolicyOptions::default() });
        match output {
            "several" => assert_eq!(facts.unwrap().outputs[0].role, OutputRole::Discrete(3)),
            "normal" => assert_eq!(facts.unwrap().outputs[0].role, OutputRole::Continuous(3)),
            _ => assert!(facts.unwrap_err().to_string().contains("nothing is the likeliest")),
        }
    }
}

#[test]
fn numbers_that_are_constant_or_drawn_are_no_states() {
    let file = File::default()
        .input("obs", Float, &["1", "3"])
        .input("goal", Float, &["1", "3"])
        .constant("version", &[1, 3], &[1.0; 3])
        .node("Add", &["obs", "goal"], "mean")
        .node("RandomNormalLike", &["mean"], "noise")
        .node("Add", &["mean", "noise"], "drawn")
        .node("Identity", &["version"], "kept")
        .output("mean")
        .output("drawn")
        .output("kept");
    let outputs = vec!["mean".to_owned()];
    let facts = file.read(&PolicyOptions { outputs, ..PolicyOptions::default() }).unwrap();
    assert_eq!(facts.inputs.len(), 2);
}

#[test]
fn a_mask_of_floats_is_known_by_its_name_or_by_its_use() {
    let masked = |name: &str| {
        let cast = vec![pb::AttributeProto {
            i: Bool as i64,
            name: "to".into(),
            r#type: 2,
            ..Default::default()
        }];
        File::default()
            .input("obs", Float, &["1", "3"])
            .input(name, Float, &["1", "3"])
            .input("seen_mask", Float, &["1", "4"])
            .node_with("Cast", &[name], "flags", cast)
            .node("Where", &["flags", "obs", "obs"], "chosen")
            .node("ReduceSum", &["seen_mask"], "sum")
            .node("Add", &["chosen", "sum"], "logits")
            .output("logits")
    };
    for name in ["open", "action_masks"] {
        let facts = masked(name).found();
        assert_eq!(named(&facts, InputRole::Available), [name]);
        assert_eq!(named(&facts, InputRole::Extra), ["seen_mask"]);
        assert_eq!(named(&facts, InputRole::Observation), ["obs"]);
    }
    let alone = File::default().input("mask", Float, &["1", "4"]).layer("mask", [4, 3], "q");
    assert_eq!(named(&alone.output("q").found(), InputRole::Observation), ["mask"]);
}

#[test]
fn means_that_a_file_normalises_by_are_known() {
    let seen = |first: &str, second: &str| {
        File::default()
            .input("obs", Float, &["1", "2"])
            .constant("a", &[1, 2], &[50.0, -3.0])
            .constant("b", &[1, 2], &[0.5, 4.0])
            .node("Flatten", &["obs"], "flat")
            .node(first, &["flat", "a"], "shifted")
            .node(second, &["shifted", "b"], "normal")
            .layer("normal", [2, 3], "q")
            .output("q")
    };
    let normals = |file: &File| file.found().inputs[0].normals.clone();
    assert_eq!(normals(&seen("Sub", "Div")), [[50.0, 0.5], [-3.0, 4.0]]);
    assert_eq!(normals(&seen("Add", "Mul")), [[-50.0, 2.0], [3.0, 0.25]]);
    for (first, second) in [("Div", "Sub"), ("Sub", "Sub"), ("Max", "Div")] {
        assert!(normals(&seen(first, second)).is_empty(), "{first} {second}");
    }
}
