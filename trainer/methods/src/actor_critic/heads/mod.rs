//! Soft actor-critics with several heads (dissertation section 4.4): each head has policies of its own, and values of the
//! team's reward and of a reward that only this head is paid. All learn from what any of them did.

mod critic;
mod learner;

pub use critic::{HeadCritic, HeadCriticShape};
pub use learner::{HeadBatch, HeadLearner, HeadRules};
