//! What methods share whose agents have policies, and critics while they learn (dissertation chapters 3 and 4): groups of
//! agents that share networks, policies and how they act, losses, an update of policies and critic.

pub(crate) mod acting;
pub(crate) mod critic;
pub(crate) mod deployed;
pub(crate) mod groups;
pub(crate) mod learner;
pub(crate) mod losses;
pub(crate) mod policies;
pub(crate) mod rules;
