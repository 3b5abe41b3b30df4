//! Why a process could not start or go on.

use std::io;
use std::path::PathBuf;
use std::process::ExitStatus;

use sortie_core::link::LinkError;
use sortie_core::roles::{AllocatorError, WorldError};
use sortie_core::wire::{ABI, LayoutError};
use sortie_line::LineError;

/// What ended a process of a domain.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The domain's name cannot be used in paths.
    #[error("`{0}` is no domain id: it takes 1 to 24 of `a` to `z`, `0` to `9` and `-`")]
    DomainId(String),
    /// Shared memory, or the domain's directory, cannot be used.
    #[error("{path}: {problem}")]
    Directory {
        /// The directory.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A file of the domain could not be used.
    #[error("cannot {action} {path}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Why it failed.
        source: io::Error,
    },
    /// A process of the team could not be started.
    #[error("cannot start {name}")]
    Spawn {
        /// What it was to be.
        name: String,
        /// Why it failed.
        source: io::Error,
    },
    /// Another process already has this role.
    #[error("{what} of domain `{domain}` is already taken{}", holder(*.pid))]
    Busy {
        /// The role.
        what: String,
        /// The domain.
        domain: String,
        /// The process that has it; 0 = unknown.
        pid: u64,
    },
    /// The domain's team has another bundle, or allocates by another rule.
    #[error("domain `{domain}` has a team of another {what}: {ours} here, {theirs} there")]
    OtherTeam {
        /// The domain.
        domain: String,
        /// What differs: the bundle, or the allocation rule.
        what: &'static str,
        /// This process's.
        ours: String,
        /// The team's.
        theirs: String,
    },
    /// A line to another host is not there.
    #[error(transparent)]
    Line(#[from] LineError),
    /// No world came.
    #[error("no world has started in domain `{domain}`")]
    NoWorld {
        /// The domain.
        domain: String,
    },
    /// No world has come in the place of one that died.
    #[error("domain `{domain}` has had no world for {seconds} s")]
    Abandoned {
        /// The domain.
        domain: String,
        /// How long that was waited for.
        seconds: u64,
    },
    /// Nobody serves a policy.
    #[error(
        "no policy is served in domain `{domain}`: start `sortie serve PLAN --domain {domain}`"
    )]
    NoServer {
        /// The domain.
        domain: String,
    },
    /// The policy that is served takes or gives something else than this process expects.
    #[error("domain `{domain}` serves another policy: {detail}")]
    OtherPolicy {
        /// The domain.
        domain: String,
        /// The first difference.
        detail: String,
    },
    /// A policy that messages cannot carry.
    #[error("the policy cannot be served: {problem}")]
    NotServed {
        /// What is too much.
        problem: String,
    },
    /// An observation whose lengths are not the policy's.
    #[error("the observation does not fit the policy: {problem}")]
    BadObservation {
        /// What differs.
        problem: String,
    },
    /// This process was made for another domain than the one that runs.
    #[error(
        "domain `{domain}` runs another contract: here {ours:016x}, there {theirs:016x}; {detail}"
    )]
    Contract {
        /// The domain.
        domain: String,
        /// Hash of this process's contract.
        ours: u64,
        /// Hash of the domain's contract.
        theirs: u64,
        /// The first field that differs.
        detail: String,
    },
    /// The domain's team runs at another rate.
    #[error("domain `{domain}` has a team that runs {}, this one would {}", rate(*.theirs), rate(*.ours))]
    OtherRate {
        /// The domain.
        domain: String,
        /// This process's time from frame to frame, in nanoseconds; 0 = as long as the team takes.
        ours: u64,
        /// The team's.
        theirs: u64,
    },
    /// The domain's world is of another kind.
    #[error("domain `{domain}` has another world: {detail}")]
    OtherWorld {
        /// The domain.
        domain: String,
        /// The first difference.
        detail: String,
    },
    /// A runner that reads world frames in a domain whose frames are private, or the other way round.
    #[error("domain `{domain}` {}", frames(*.are_private))]
    Frames {
        /// The domain.
        domain: String,
        /// What the domain has.
        are_private: bool,
    },
    /// A runner that is to get private frames of several agents, or of none.
    #[error("a runner with private frames acts for one agent, not for {agents:?}")]
    NotOneAgent {
        /// The agents asked for.
        agents: Vec<u16>,
    },
    /// The services of the domain carry another schema or ABI.
    #[error("domain `{domain}` runs another schema than {schema:016x}, or another ABI than {ABI}")]
    SchemaInUse {
        /// The domain.
        domain: String,
        /// This process's schema.
        schema: u64,
    },
    /// The domain is larger than what this process was made for.
    #[error("the domain has {got} {what}, the model takes at most {max}")]
    Limits {
        /// What is too many.
        what: &'static str,
        /// The domain's number.
        got: usize,
        /// This process's limit.
        max: usize,
    },
    /// An agent that the domain does not have, or none at all.
    #[error("no such agents: {agents:?}; the domain has {count}, from 0")]
    NoSuchAgent {
        /// The agents asked for.
        agents: Vec<u16>,
        /// Agents of the domain.
        count: usize,
    },
    /// A file of the domain has content that cannot be read.
    #[error("{path}: {problem}")]
    BadFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The shape cannot be carried by frames.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// Shared memory could not be set up.
    #[error("shared memory: {what}: {problem}")]
    SharedMemory {
        /// The service, port or node.
        what: String,
        /// The reason that the library gives.
        problem: String,
    },
    /// A topic failed while running.
    #[error("shared memory: {0}")]
    Link(#[from] LinkError),
    /// The world ended early.
    #[error(transparent)]
    World(WorldError),
    /// The allocator ended early.
    #[error(transparent)]
    Allocator(AllocatorError),
    /// A process of the team ended early.
    #[error("{name} {}", ending(.status))]
    Child {
        /// What it was.
        name: String,
        /// How it ended.
        status: ExitStatus,
    },
    /// A process ends again and again as soon as it is started.
    #[error("{name} {}, for the {times}th time in a row; it is not started again", ending(.status))]
    KeepsDying {
        /// What it was.
        name: String,
        /// How often it was started in vain.
        times: u32,
        /// How it ended at last.
        status: ExitStatus,
    },
    /// The system does not give what a role asks for.
    #[error("{what} is refused; {advice}, or run as the superuser")]
    RealTime {
        /// The core, the priority, or the memory.
        what: String,
        /// What the user may do.
        advice: &'static str,
        /// The system's reason.
        source: io::Error,
    },
    /// The team in one thread waits for itself.
    #[error("the team stands still: no role has anything to do")]
    Stalled,
    /// A signal ended the process.
    #[error("interrupted")]
    Interrupted,
}

impl Error {
    /// The exit code that scripts rely on.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::DomainId(_) | Self::NoSuchAgent { .. } | Self::NotOneAgent { .. } => 2,
            Self::BadFile { .. } | Self::Layout(_) => 65,
            Self::NotServed { .. } | Self::BadObservation { .. } => 65,
            Self::World(WorldError::Unavailable(_)) => 65,
            Self::Allocator(AllocatorError::Refused { .. }) => 65,
            Self::World(WorldError::Link(_)) => 74,
            Self::NoWorld { .. } | Self::NoServer { .. } | Self::Abandoned { .. } => 69,
            Self::World(_) => 69,
            // What ended the process of the team says more than that it ended.
            Self::Child { status, .. } | Self::KeepsDying { status, .. } => match status.code() {
                Some(code @ (65 | 66 | 70 | 74 | 75 | 77 | 78 | 141)) => code as u8,
                _ => 69,
            },
            Self::Stalled => 70,
            Self::Directory { .. } | Self::Io { .. } | Self::Spawn { .. } => 74,
            Self::SharedMemory { .. } | Self::Link(_) | Self::Allocator(_) => 74,
            Self::Busy { .. } | Self::OtherTeam { .. } | Self::OtherRate { .. } => 75,
            Self::RealTime { .. } => 77,
            Self::Contract { .. } | Self::SchemaInUse { .. } | Self::Limits { .. } => 78,
            Self::Frames { .. } | Self::OtherPolicy { .. } | Self::OtherWorld { .. } => 78,
            Self::Line(LineError::Carrier { .. }) => 74,
            Self::Line(LineError::NoAnswer { .. }) => 69,
            Self::Line(LineError::Busy { .. }) => 75,
            Self::Line(LineError::Refused { .. }) => 78,
            Self::Interrupted | Self::Line(LineError::Interrupted) => 130,
        }
    }

    /// Wraps a failed file operation.
    pub(crate) fn io(
        action: &'static str,
        path: impl Into<PathBuf>,
    ) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { action, path, source }
    }
}

fn frames(are_private: bool) -> &'static str {
    if are_private {
        "gives every agent its own frame, this runner would read the world's: start it with private frames"
    } else {
        "has one frame for all, this runner would wait for its own: start it without private frames"
    }
}

/// A time from frame to frame as people say it, in nanoseconds.
fn rate(period_ns: u64) -> String {
    match period_ns {
        0 => "as fast as it acts".to_string(),
        // Six digits: a rate that was asked for comes back as it was written.
        period => {
            let hz = 1e9 / period as f64;
            let digits = 10_f64.powi(5 - hz.log10().floor() as i32);
            format!("at {} Hz", (hz * digits).round() / digits)
        }
    }
}

fn holder(pid: u64) -> String {
    if pid == 0 { String::new() } else { format!(" by process {pid}") }
}

/// How a process ended, as the end of a sentence.
pub(crate) fn ending(status: &ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(signal)) => format!("was killed by signal {signal}"),
        (None, None) => "ended".to_string(),
    }
}
