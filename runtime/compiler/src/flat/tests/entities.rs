//! Networks over entities: which input is which is said, and what is said wrongly is answered by what there is.

use sortie_plans::{InputRole, PolicyFacts, PolicyOptions};
use tract_onnx::pb;
use tract_onnx::pb::tensor_proto::DataType::{Bool, Float, Int64};

use super::files::File;

/// Sums of what a mask leaves, beside the row that an index finds.
fn file() -> File {
    let axis = pb::AttributeProto { name: "axis".into(), i: 1, r#type: 2, ..Default::default() };
    File::default()
        .input("rows", Float, &["1", "4", "3"])
        .input("pad", Bool, &["1", "4"])
        .input("me", Int64, &["1"])
        .input("legal", Bool, &["1", "3"])
        .whole("axis", &[-1])
        .whole("middle", &[1])
        .constant("none", &[1], &[0.0])
        .node_with("Gather", &["rows", "me"], "own", vec![axis])
        .node("Unsqueeze", &["pad", "axis"], "column")
        .node("Where", &["column", "none", "rows"], "shown")
        .node("ReduceSum", &["shown", "middle"], "sum")
        .node("Add", &["sum", "own"], "both")
        .node("Where", &["legal", "both", "none"], "q")
        .output("q")
}

fn said(entities: &str, mask: Option<&str>, own: Option<&str>) -> Result<PolicyFacts, String> {
    let named = |name: &str| Some(name.to_owned());
    let (mask, own) = (mask.and_then(named), own.and_then(named));
    let entities = (!entities.is_empty()).then(|| entities.to_owned());
    let options = PolicyOptions { entities, mask, own, ..PolicyOptions::default() };
    file().read(&options).map_err(|error| error.to_string())
}

#[test]
fn entities_have_the_roles_that_are_said() {
    let roles = |own| -> Vec<InputRole> {
        let facts = said("rows", Some("pad:blocked"), Some(own)).unwrap();
        facts.inputs.iter().map(|input| input.role).collect()
    };
    let entities = |own_first| InputRole::Entities { own_first };
    let mask = |own_first| InputRole::Mask { blocks: true, own_first };
    let available = InputRole::Available;
    assert_eq!(roles("me"), [entities(false), mask(false), InputRole::OwnIndex, available]);
    assert_eq!(roles("first"), [entities(true), mask(true), InputRole::Extra, available]);
    let told = said("", None, Some("me")).unwrap();
    let role = |name: &str| told.inputs.iter().find(|input| input.name == name).unwrap().role;
    assert_eq!([role("rows"), role("me")], [InputRole::Observation, InputRole::OwnIndex]);
    let visible = said("rows", Some("pad:visible"), Some("me")).unwrap();
    let role = InputRole::Mask { blocks: false, own_first: false };
    assert!(visible.inputs.iter().any(|input| input.role == role));
}

#[test]
fn what_is_missing_is_asked_for_with_what_there_is() {
    for (got, words) in [
        (said("rows", None, None), ["`pad` bool [1, 4]", "`--mask NAME:visible`"]),
        (said("rows", Some("pad"), None), ["`pad` bool [1, 4]", "`--mask NAME:blocked`"]),
        (said("rows", Some("legal:visible"), None), ["`pad` bool [1, 4]", "--mask"]),
        (said("rows", Some("pad:blocked"), None), ["`me` i64 [1]", "`--self first`"]),
        (said("rows", Some("pad:blocked"), Some("legal")), ["`me` i64 [1]", "`--self NAME`"]),
        (
            said("rows", Some("pad:blocked"), Some("you")),
            ["no number of the own row `you`", "`me`"],
        ),
        (
            said("row", Some("pad:blocked"), None),
            ["no input of entities `row`", "`rows` f32 [1, 4, 3]"],
        ),
        (said("me", Some("pad:blocked"), None), ["`rows` f32 [1, 4, 3]", "`--entities NAME`"]),
        (said("", Some("pad:blocked"), None), ["`rows` f32 [1, 4, 3]", "`--entities NAME`"]),
        (said("", None, Some("first")), ["`rows` f32 [1, 4, 3]", "`--entities NAME`"]),
        (said("", None, Some("legal")), ["`me` i64 [1]", "`--self NAME`"]),
    ] {
        let message = got.unwrap_err();
        assert!(words.iter().all(|word| message.contains(word)), "{words:?}: {message}");
    }
}
