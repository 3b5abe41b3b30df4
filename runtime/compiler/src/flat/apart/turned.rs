//! Recurrent units that go backwards as ones that go forwards over a history that is turned round.

use tract_onnx::pb::NodeProto;

use super::Parts;

pub(super) fn is_backwards(node: &NodeProto) -> bool {
    node.attribute
        .iter()
        .any(|attribute| attribute.name == "direction" && attribute.s == b"reverse")
}

pub(super) fn write(parts: &mut Parts<'_>) -> Option<()> {
    // Lengths would be of the turned history.
    if parts.input(4).is_some() || parts.whole("layout") != 0 {
        return None;
    }
    let history = parts.backwards(&parts.input(0)?, 0);
    let all = parts.name("all", 0);
    let mut unit = parts.node.clone();
    unit.attribute.retain(|attribute| attribute.name != "direction");
    *unit.input.first_mut()? = history;
    if parts.is_wanted(0) {
        *unit.output.first_mut()? = all.clone();
    }
    parts.nodes.push(unit);
    let all = parts.backwards(&all, 0);
    parts.give(0, &all)
}
