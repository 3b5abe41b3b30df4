//! Rules and relations of an environment, by the names of the command line.

use sortie_envs::Entry;
pub use sortie_stage::{FrameRelation, RuleAllocator};

use crate::allocation::Allocation;
use crate::failure::{Exit, Failure};

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
