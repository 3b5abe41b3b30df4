//! Which outputs are wanted, and what they are.

use sortie_plans::{OutputRole, ValueType};

use crate::flat::selection::{Kind, Told, role, wanted};
use crate::flat::values::Value;

fn value(name: &str, kind: ValueType, shape: &[usize]) -> Value {
    Value { name: name.to_owned(), kind: Some(kind), shape: Some(shape.to_vec()), is_flag: false }
}

/// The wanted ones of floats of these names; those that start with `!` are choices, with `?` drawn, with `=` constant.
fn chosen(names: &[&str], asked: &[&str]) -> Result<Vec<String>, String> {
    let values: Vec<Value> =
        names.iter().map(|name| value(name, ValueType::F32, &[1, 5])).collect();
    let asked: Vec<String> = asked.iter().map(ToString::to_string).collect();
    let values: Vec<&Value> = values.iter().collect();
    let told = |value: &Value| Told {
        is_choice: value.name.starts_with('!') || value.name == "discrete_action",
        is_drawn: value.name.contains('?'),
        is_constant: value.name.contains('='),
    };
    let found = wanted(&values, told, &asked);
    let found = found.map_err(|error| error.to_string())?;
    Ok(found.into_iter().map(|wanted| wanted.name).collect())
}

#[test]
fn a_choice_comes_before_names_and_names_before_the_only_output() {
    assert_eq!(chosen(&["action", "!x", "q"], &[]).unwrap(), ["!x"]);
    for name in ["action", "Actions", "q", "q_values", "logits", "policy"] {
        assert_eq!(chosen(&["value", name, "log_prob"], &[]).unwrap(), [name]);
    }
    assert_eq!(chosen(&["29"], &[]).unwrap(), ["29"]);
    assert_eq!(chosen(&["mu", "log_std", "value"], &[]).unwrap(), ["mu"]);
    let drawn = ["continuous_actions", "deterministic_continuous_actions", "action_shape"];
    assert_eq!(chosen(&drawn, &[]).unwrap(), drawn[1..2]);
    let both = ["!x", "deterministic_continuous_actions", "deterministic_discrete_actions"];
    assert_eq!(chosen(&both, &[]).unwrap(), both[1..]);
    assert_eq!(chosen(&["value", "continuous_actions"], &[]).unwrap(), ["continuous_actions"]);
    let heads = ["discrete_action", "value", "continuous_action"];
    assert_eq!(chosen(&heads, &[]).unwrap(), [heads[0], heads[2]]);
}

#[test]
fn what_is_drawn_or_never_changes_stands_back() {
    assert_eq!(chosen(&["action?", "action_mean", "value"], &[]).unwrap(), ["action_mean"]);
    assert_eq!(chosen(&["action?", "value"], &[]).unwrap(), ["action?"]);
    assert_eq!(chosen(&["action=", "action", "="], &[]).unwrap(), ["action"]);
    assert_eq!(chosen(&["action=", "x"], &["action="]).unwrap(), ["action="]);
    assert_eq!(chosen(&["x", "x:likeliest"], &["x:likeliest"]).unwrap(), ["x:likeliest"]);
    assert_eq!(chosen(&["x", "y"], &["x:likeliest"]).unwrap(), ["x"]);
}

#[test]
fn what_is_not_clear_is_listed_with_the_flag() {
    for names in [["!x", "!y"], ["action", "q"], ["mean", "log_std"]] {
        let message = chosen(&names, &[]).unwrap_err();
        for word in [names[0], names[1], "--output NAME"] {
            assert!(message.contains(word), "{word}: {message}");
        }
    }
    assert!(chosen(&[], &[]).is_err());
}

#[test]
fn outputs_that_are_asked_for_come_in_the_order_of_the_file() {
    assert_eq!(chosen(&["a", "!b", "c"], &["c", "a"]).unwrap(), ["a", "c"]);
    assert_eq!(chosen(&["a", "a:discrete"], &["a:discrete"]).unwrap(), ["a:discrete"]);
    assert_eq!(chosen(&["a", "b"], &["a:discrete"]).unwrap(), ["a"]);
    let message = chosen(&["a", "b"], &["x"]).unwrap_err();
    assert!(message.contains("`x`") && message.contains("`a` f32 [1, 5]"), "{message}");
}

#[test]
fn numbers_are_scores_by_name_or_mask_and_else_the_action_itself() {
    let mask = value("mask", ValueType::Bool, &[1, 5]);
    let of = |name: &str, said, masks: &[&Value]| {
        role(&value(name, ValueType::F32, &[2, 5]), said, None, masks)
    };
    for name in ["q", "Q_values", "logits", "action_logits"] {
        assert_eq!(of(name, None, &[]), OutputRole::Discrete(5), "{name}");
    }
    for name in ["actions", "mean", "29"] {
        assert_eq!(of(name, None, &[]), OutputRole::Continuous(10), "{name}");
    }
    assert_eq!(of("29", None, &[&mask]), OutputRole::Discrete(5));
    assert_eq!(of("actions", None, &[&mask]), OutputRole::Continuous(10));
    assert_eq!(of("29", Some(Kind::Discrete), &[]), OutputRole::Discrete(5));
    assert_eq!(of("q", Some(Kind::Continuous), &[]), OutputRole::Continuous(10));
    let place = value("q", ValueType::I64, &[1]);
    assert_eq!(role(&place, None, Some(7), &[]), OutputRole::Discrete(7));
    assert_eq!(role(&place, None, None, &[]), OutputRole::Continuous(1));
}
