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
