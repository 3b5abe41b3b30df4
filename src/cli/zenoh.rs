//! Which program has zenoh, and what it does for the others.
//!
//! `sortie-zenoh` lies beside `sortie` and takes the same words: what zenoh brings takes longer to compile than all of `sortie`,
//! which goes on as that program where a line or a node of ROS 2 goes through zenoh.

use std::env;
use std::io;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use clap::ValueEnum;
use serde::Serialize;
use sortie_core::wire::FrameFormat;
use sortie_ipc::{Heard, PolicySchema};
use sortie_line::Carrier;

use crate::failure::{Exit, Failure, Outcome};
use crate::tools::running;

/// The file that the program is.
const FILE: &str = "sortie-zenoh";

const BUILD: &str = "build it with `cargo build --release --manifest-path runtime/zenoh/Cargo.toml --target-dir target`";

/// What a program has that is `sortie-zenoh`.
pub trait Zenoh: Sync {
    /// Opens one end of a line.
    fn line(&self, line: &LineThrough<'_>) -> Result<Arc<dyn Carrier>, Failure>;

    /// Opens a node of ROS 2 that passes on what a team says.
    fn team(&self, node: &RosNode<'_>, team: RosTeam) -> Result<Box<dyn TeamNode>, Failure>;

    /// Opens a node of ROS 2 behind which a policy decides.
    fn policy(
        &self,
        node: &RosNode<'_>,
        policy: &PolicySchema,
    ) -> Result<Box<dyn PolicyNode>, Failure>;
}

/// One end of a line through zenoh.
#[derive(Clone, Copy, Debug)]
pub struct LineThrough<'a> {
    /// Whether it is the team's.
    pub is_home: bool,
    /// Where it listens, or goes to, as zenoh writes it: `tcp/192.168.1.5:7447`. None: its configuration says.
    pub locator: Option<&'a str>,
    /// A file of zenoh's own.
    pub configuration: Option<&'a Path>,
    /// The team's domain and the agents that are away, none for an allocator, by which lines through one router are told apart.
    pub domain: &'a str,
    pub agents: &'a [u16],
}

/// A node of ROS 2, and where those that it speaks to are.
#[derive(Clone, Copy, Debug)]
pub struct RosNode<'a> {
    /// Where the router is, as zenoh writes it. None: the configuration says.
    pub router: Option<&'a str>,
    /// A file of zenoh's own.
    pub configuration: Option<&'a Path>,
    /// `ROS_DOMAIN_ID`.
    pub domain: u32,
    pub namespace: &'a str,
    pub name: &'a str,
    pub release: RosRelease,
}

/// What the hosts with ROS run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RosRelease {
    /// Without hashes of types
    Humble,
    /// Jazzy and later
    Jazzy,
}

/// What has to be known of a team.
#[derive(Clone, Copy, Debug)]
pub struct RosTeam {
    pub format: FrameFormat,
    /// How much more the time since 1970 is than that of the domain's clock.
    pub ahead_ns: u64,
}

/// Passes on what a team says.
pub trait TeamNode {
    fn hear(&mut self, heard: Heard<'_>) -> Outcome;

    fn passed_on(&self) -> PassedOn;
}

/// How many messages were passed on; who is not listened to says nothing.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PassedOn {
    pub observations: u64,
    pub actions: u64,
    pub allocations: u64,
    /// Messages that are no message of this team, or contradict themselves.
    pub refused: u64,
}

impl PassedOn {
    pub(crate) fn all(self) -> u64 {
        let Self { observations, actions, allocations, refused: _ } = self;
        observations + actions + allocations
    }
}

/// Reads what a robot observes, and says what it is to do.
pub trait PolicyNode: Send {
    /// The next that came, waited for no longer than this.
    fn next(&mut self, most: Duration) -> Result<Option<FromRobot>, Failure>;

    /// All outputs, one behind the other, or the action that was chosen.
    fn answer(&mut self, answer: ToRobot<'_>) -> Outcome;
}

/// What comes from a robot.
#[derive(Clone, Debug, PartialEq)]
pub enum FromRobot {
    /// The numbers of all inputs, one behind the other.
    Observation(Vec<f32>),
    /// The next observation begins an episode.
    Reset,
    /// What is no observation of this policy, and why.
    Refused(String),
}

/// What a robot is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ToRobot<'a> {
    Outputs(&'a [f32]),
    Choice(u16),
}

/// Zenoh, as far as this program has it; where it has not, the one that has goes on in its place.
pub(crate) fn linked() -> Result<&'static dyn Zenoh, Failure> {
    running().and_then(|program| program.zenoh).ok_or_else(become_zenoh)
}

/// Fails early where neither this program nor the one beside it has zenoh.
pub(crate) fn check() -> Outcome {
    match running().and_then(|program| program.zenoh) {
        Some(_) => Ok(()),
        None => check_program(),
    }
}

fn program() -> PathBuf {
    env::current_exe().unwrap_or_default().with_file_name(FILE)
}

/// Goes on as the program with zenoh; returns only where that cannot be started.
fn become_zenoh() -> Failure {
    if let Err(failure) = check_program() {
        return failure;
    }
    not_started(&Command::new(program()).args(env::args_os().skip(1)).exec())
}

/// Whether that program is there, and of this version: both speak to the same team.
fn check_program() -> Outcome {
    let said = Command::new(program()).arg("--version").stdin(Stdio::null()).output();
    let said = said.map_err(|error| not_started(&error))?;
    let said = String::from_utf8_lossy(&said.stdout);
    let got = said.lines().next().unwrap_or_default().trim_start_matches("sortie ").trim();
    let want = running().map_or("", |program| program.version);
    if got == want {
        return Ok(());
    }
    let message = format!("`{}` is version {got}, this is {want}: {BUILD}", program().display());
    Err(Failure::new(Exit::Mismatch, message))
}

fn not_started(error: &io::Error) -> Failure {
    let program = program();
    let message = match error.kind() {
        io::ErrorKind::NotFound => {
            format!("zenoh is in `{FILE}`, which is not at `{}`: {BUILD}", program.display())
        }
        _ => format!("`{}`: {error}", program.display()),
    };
    Failure::new(Exit::NotRunning, message)
}
