//! What methods share whose agents have policies and rewards of their own (dissertation chapters 3 and 4): groups of
//! agents that share networks, policies, memory, decisions that hold, losses of policies, graphs to deploy.

pub(crate) mod acting;
pub(crate) mod batch;
pub(crate) mod groups;
pub(crate) mod heads;
pub(crate) mod losses;
pub(crate) mod replay;
