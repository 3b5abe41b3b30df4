//! Pages in a browser, which must be installed.

mod chromium;
mod environments;
mod live;
#[path = "../support/mod.rs"]
mod support;
mod view;
