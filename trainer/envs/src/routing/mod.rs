//! Routes: vehicles of limited capacity serve customers from one depot, as short as possible together (the capacitated
//! vehicle routing problem; dissertation section 7.4, figure 7.3).
//!
//! Customers are subtasks, and all that is decided is who goes where: an agent heads for the place that it is allocated.
//! Vehicles move in rounds, straight and all at once. The dissertation's instances are not public: those here are drawn as
//! Nazari et al. (2018) and Kool et al. (2019) draw theirs, and measured against their exact optimum.
//!
//! Nothing in a total length asks for more than one vehicle: whoever may send them out one by one does so. A vehicle
//! therefore leaves the depot only while none is outside, so that all routes of a wave are driven at the same time, but in
//! `sequential` sets.

mod environment;
mod exact;
mod frames;
mod instance;
mod observation;
mod picture;
mod rules;
mod tour;

pub use environment::{ENTRY, Routing};
pub use exact::optimum;
pub use instance::{CUSTOMERS, Instance};

/// The version of the rules: another one where a trained policy would notice the difference.
pub const VERSION: &str = "1";
#[cfg(test)]
mod tests;
