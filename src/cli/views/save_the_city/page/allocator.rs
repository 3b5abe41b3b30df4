//! Who assigned agents in the episode that is viewed.

use crate::allocation::{Allocation, AllocatorChoice};

/// Who allocated in a recording of `sortie eval --episodes-out`, by its label, where that can be
/// computed again: random choices are lost.
pub(super) fn of_label(policy: &str) -> Option<AllocatorChoice> {
    let (_, allocation) = policy.rsplit_once(", ")?;
    let name = allocation.strip_suffix(" allocation")?;
    match name {
        "learned" => Some(AllocatorChoice::Learned),
        "random" => None,
        rule => Allocation::named(rule).ok().map(AllocatorChoice::Rule),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_own_recordings_name_who_allocated() {
        let name = |label| of_label(label).map(AllocatorChoice::name);
        assert_eq!(name("runs/a, b, heuristic allocation"), Some("heuristic"));
        assert_eq!(name("scripted, coordinated allocation"), Some("coordinated"));
        assert_eq!(name("runs/a, learned allocation"), Some("learned"));
        for unknown in ["scripted, random allocation", "a, planned from learned allocation", "a"] {
            assert_eq!(name(unknown), None);
        }
    }
}
