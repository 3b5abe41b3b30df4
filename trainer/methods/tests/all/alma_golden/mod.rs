//! Networks and learners against the reference's modules, on recorded inputs (`tests/golden`).

mod allocation;
mod coach;
mod low_level;
mod networks;
mod popart;
mod reference;
mod windows;
