//! The built-in worlds of `run`: environments behind the runtime's traits, which pages in a browser play in as well.

use sortie_envs::Entry;

use crate::allocation::Allocation;
use crate::failure::{Exit, Failure};

pub use sortie_stage::{FrameRelation, RuleAllocator, tally, world};

/// A rule of allocation; `seed` matters to rules that draw.
pub fn rule_allocator(
    entry: &Entry,
    rule: Allocation,
    seed: u64,
) -> Result<RuleAllocator, Failure> {
    let rule = rule.number(entry)?;
    RuleAllocator::new(entry, rule, seed).ok_or_else(|| unread(entry))
}

/// How entities of an environment stand to subtasks.
pub fn relation(entry: &Entry) -> Result<FrameRelation, Failure> {
    FrameRelation::new(entry).ok_or_else(|| unread(entry))
}

fn unread(entry: &Entry) -> Failure {
    let message = format!("nobody can be allocated by frames of `{}`", entry.name);
    Failure::new(Exit::Usage, message)
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};
    use std::path::Path;

    use sortie_core::Allocator;

    use super::*;
    use crate::deployment::open_bundle;
    use crate::environment::entry_of;

    #[test]
    fn states_of_the_same_subtasks_and_agents_give_other_draws() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/save-the-city");
        let bundle = open_bundle(&folder).expect("the shipped bundle");
        let entry = entry_of(&bundle).expect("its environment");
        let rule = Allocation::named("random").expect("a rule that draws");
        let mut rule = rule_allocator(entry, rule, 5).expect("it reads frames");
        let mut drawn: BTreeMap<_, BTreeSet<Vec<u8>>> = BTreeMap::new();
        for case in &bundle.golden().allocations {
            let state = case.state.view();
            let mut allocation = vec![0; state.agents];
            rule.allocate(&state, &mut allocation).expect("a recorded state");
            let living = (0..state.agents).filter(|agent| state.present.contains(*agent));
            let alike = (state.open_tasks, living.collect::<Vec<_>>());
            drawn.entry(alike).or_default().insert(allocation);
        }
        assert!(drawn.values().any(|drawn| drawn.len() > 1), "{drawn:?}");
    }
}
