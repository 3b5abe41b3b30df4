//! How runs are watched and compared.
//!
//! While a run learns: its curve as CSV ([`csv`]) and for TensorBoard ([`RunEvents`]). Afterwards, or
//! beside: [`RunRecord`] reads what a run wrote, [`Group`] gathers the seeds of one method, and
//! [`Comparison`] says how methods did, as tables and as pictures ([`chart`]).

pub mod chart;
mod comparison;
pub mod csv;
mod events;
mod group;
pub mod numbers;
mod output;
mod record;
mod row;
mod table;
pub mod tensorboard;

pub use comparison::{Comparison, GroupSummary, Reached, RunSummary, TeamSummary, Until};
pub use events::RunEvents;
pub use group::{Axis, Group, Sample, Spread};
pub use output::write;
pub use record::{FinalResult, Point, RunRecord};
pub use row::Row;
