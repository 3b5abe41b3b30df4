//! Who assigned agents in the episode that is viewed.

use crate::allocation::AllocatorChoice;

/// Who allocated in a recording of `sortie eval --episodes-out`, by its label, where that can be
/// computed again: random choices are lost.
pub(super) fn of_label(policy: &str) -> Option<AllocatorChoice> {
    let (_, allocation) = policy.rsplit_once(", ")?;
    let name = allocation.strip_suffix(" allocation")?;
    let known =
        [AllocatorChoice::Learned, AllocatorChoice::Coordinated, AllocatorChoice::Heuristic];
    known.into_iter().find(|choice| choice.name() == name)
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
