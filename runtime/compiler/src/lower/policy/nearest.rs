//! What stands nearest to an operator without a step.

/// The hint of the error that names such a node.
pub(super) fn nearest(operator: &str) -> &'static str {
    match operator {
        "GatherElements" | "GatherNd" | "Compress" => {
            "it has no step, the nearest that has is Gather along one axis"
        }
        "Scan" | "ScanLoop" | "If" => {
            "loops and branches have no step, the nearest that has is a GRU or LSTM cell of one step, its state an input and an output"
        }
        "Topk" | "Sort" => {
            "it has no step, the nearest that has is an ArgMax that gives the action"
        }
        "ConvTranspose" | "DeconvSum" | "Deconv" => "it has no step, the nearest that has is Conv",
        _ => "it has no step, docs/operators.md lists what has",
    }
}
