//! What the plans of an allocator that points are compiled as.

use crate::policy::PolicyOptions;

/// What encoder and decoder are compiled as: they choose no action, and no input is a mask of those.
pub fn pointing_policies() -> [PolicyOptions; 2] {
    ["tables", "scores"].map(|output| PolicyOptions {
        outputs: vec![format!("{output}:continuous")],
        states: vec!["none".to_owned()],
        available: Some("none".to_owned()),
        ..PolicyOptions::default()
    })
}
