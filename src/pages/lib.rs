//! Episodes to look at: one as a page that needs nothing but a browser, a state as lines of text for a terminal. Both draw any
//! environment by its [`Picture`](sortie_envs::Picture) and its [`Spec`](sortie_envs::Spec).
#![forbid(unsafe_code)]

mod capture;
mod page;
mod terminal;

pub use capture::{Captured, StepLog, TeamLog, TeamValueProbe, play, play_deployed};
pub use page::{Heading, live_page, page};
pub use terminal::{Canvas, Drawing, Scene, draw};
