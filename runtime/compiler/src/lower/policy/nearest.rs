//! What stands nearest to an operator without a step.

/// The hint of the error that names such a node.
pub(super) fn nearest(operator: &str) -> &'static str {
    match operator {
        "Compress" => "it has no step, the nearest that has is Gather along one axis",
        "ScatterElements" | "ScatterNd" => {
            "plans put numbers at constant places and add nothing to what stands there"
        }
        "Scan" | "GruSeq" => {
            "a loop becomes steps where it is known how often it turns, at most 128 times"
        }
        "Sort" => "it has no step, the nearest that has is TopK of at most 16 numbers",
        "ConvTranspose" | "DeconvSum" | "Deconv" => "it has no step, the nearest that has is Conv",
        _ => "it has no step, docs/reference/operators.md lists what has",
    }
}
