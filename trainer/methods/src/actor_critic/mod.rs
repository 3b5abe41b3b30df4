//! What methods share whose agents have policies and rewards of their own (dissertation chapters 3 and 4): groups of
//! agents that share networks, policies, memory, decisions that hold, losses of policies, graphs to deploy.

pub(crate) mod acting;
pub(crate) mod batch;
pub(crate) mod decision;
pub(crate) mod deployed;
pub(crate) mod drawing;
pub(crate) mod experience;
pub(crate) mod groups;
pub(crate) mod heads;
pub(crate) mod losses;
pub(crate) mod policies;
pub(crate) mod policy_gradient;
pub(crate) mod replay;
pub(crate) mod running;
pub(crate) mod step;
pub(crate) mod values;
