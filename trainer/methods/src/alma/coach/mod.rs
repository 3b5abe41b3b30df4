//! COPA (coach-player): flat players and a coach that sees everything and tells each of them a strategy.
//!
//! The baseline of dissertation section 7.5, after its public code. At decision points the coach draws a
//! vector for every agent, its strategy, which is added before the head of the agent's utility network
//! until the next decision; before the first it is zero. Where a team is measured the mean is told.

mod advice;
pub mod gaussian;
mod input;
mod networks;
mod passes;
mod players;
mod trunk;

pub use advice::Advice;
pub(crate) use advice::strategy_of;
pub use input::seen_input;
pub use networks::{Coach, CoachShape, Recognition, RecognitionShape};
pub use passes::{CoachPass, RecognitionPass};
pub use players::PlayerPass;
