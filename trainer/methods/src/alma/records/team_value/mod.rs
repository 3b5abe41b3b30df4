//! The team-value allocator: learns what a team at a subtask is worth, and searches the best teams.
//!
//! An allocation b is worth `Q(s, b) = sum over open subtasks t of f(s, t, team of t in b)`. f is one
//! attention network of the agents' kind with a single output: the row of the subtask's thing is the query, and
//! the keys are that thing itself, every agent (in the team or not, and how far away) and the things of the other
//! open subtasks. A team without agents is a legal input. `sortie_core::allocate` finds the best
//! allocation by the values of all teams.
//!
//! f is learned by SARSA, one target per subtask, from the subtask's own rewards. Compared
//! with the dissertation (section 7.4): a sum of one value per subtask instead of a critic of the whole
//! allocation, search instead of a proposal network, task rewards instead of the team's.

mod input;
mod loss;
mod search;
mod segments;

pub use super::team_columns::TeamColumns;
pub use input::{TeamQuery, TeamValueInput};
pub use loss::TeamValueLoss;
pub use search::{TeamSearch, TeamValueAllocator};
pub use segments::{Decision, Segment, Segments};
