//! What a process is told to do, and what it answers.

use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

use super::{ABI, assert_layout};

/// What a process can be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Command {
    /// Say who you are. Served by every process.
    Info = 1,
    /// World: stand still after the current tick.
    Pause = 2,
    /// World: go on.
    Resume = 3,
    /// World: give up the current episode and begin the next.
    ResetEpisode = 4,
    /// World: end, and the team with it. Server of a policy: end. Runner, allocator: end, where the request names its
    /// process, or means [`ControlReq::EVERYBODY`].
    ShutDown = 5,
    /// Runner, allocator: open the bundle of this name, a key of the process's own registry, beside the one in use, which
    /// stays as it is. World: note it as the one that may come next. `arg64` is the generation in use.
    PrepareBundle = 6,
    /// Leading allocator: let another one lead.
    StepDown = 7,
    /// Set the level of the process's log to `arg64`: 0 trace, 1 debug, 2 info, 3 warn, 4 error, 5 fatal.
    SetLogLevel = 8,
    /// World: change to the bundle that was prepared, as the [`SwapOrder`](super::SwapOrder) in `arg64` says.
    SwapBundle = 9,
}

impl Command {
    /// The command of this number, if there is one.
    pub fn from_number(number: u16) -> Option<Self> {
        let all = [
            Self::Info,
            Self::Pause,
            Self::Resume,
            Self::ResetEpisode,
            Self::ShutDown,
            Self::PrepareBundle,
            Self::StepDown,
            Self::SetLogLevel,
            Self::SwapBundle,
        ];
        all.into_iter().find(|command| *command as u16 == number)
    }
}

/// What became of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum ControlStatus {
    /// It is done, or is before the next tick.
    Done = 0,
    /// It is meant for another process, or for another role.
    NotMine = 1,
    /// The process knows no such command, or has nothing to do it with.
    NotSupported = 2,
    /// ABI or schema are not this domain's.
    Foreign = 3,
    /// An argument names what does not exist.
    BadArgument = 4,
    /// The team has changed its bundle meanwhile: the order is of a generation that is over.
    Outdated = 5,
}

impl ControlStatus {
    /// The status of this number, if there is one.
    pub fn from_number(number: i32) -> Option<Self> {
        let all = [
            Self::Done,
            Self::NotMine,
            Self::NotSupported,
            Self::Foreign,
            Self::BadArgument,
            Self::Outdated,
        ];
        all.into_iter().find(|status| *status as i32 == number)
    }
}

/// Tells all processes of a domain to do something, or one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
pub struct ControlReq {
    /// Hash of the contract and of A, N, T.
    pub schema: u64,
    /// A [`Command`].
    pub cmd: u16,
    /// [`ABI`].
    pub abi: u16,
    /// Process id of the one that is meant; 0 = all.
    pub arg: u32,
    /// A number for the command.
    pub arg64: u64,
    /// Comes back in the answer.
    pub token: u64,
    /// A text for the command, UTF-8, zero padded.
    pub text: [u8; 32],
}

assert_layout!(ControlReq, 64, {
    schema: 0, cmd: 8, abi: 10, arg: 12, arg64: 16, token: 24, text: 32,
});

impl ControlReq {
    /// `arg64` of [`Command::ShutDown`] where nobody waits for a world's goodbye.
    pub const EVERYBODY: u64 = 1;

    /// A command for all processes of the domain of `schema`.
    pub fn new(schema: u64, command: Command) -> Self {
        Self { schema, cmd: command as u16, abi: ABI, ..Self::new_zeroed() }
    }

    /// Whether ABI and schema are those of this domain.
    pub fn fits(&self, schema: u64) -> bool {
        self.abi == ABI && self.schema == schema
    }

    /// The text, as far as it is one.
    pub fn text(&self) -> &str {
        text(&self.text)
    }

    /// The answer of a process of the domain of `schema` at `tick`, without words.
    pub fn answer(&self, schema: u64, status: ControlStatus, tick: u64) -> ControlRep {
        let Self { cmd, token, .. } = *self;
        let status = status as i32;
        ControlRep { schema, cmd, abi: ABI, status, tick, token, text: [0; 224] }
    }
}

/// What a process answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
pub struct ControlRep {
    /// Hash of the contract and of A, N, T.
    pub schema: u64,
    /// The command answered.
    pub cmd: u16,
    /// [`ABI`].
    pub abi: u16,
    /// A [`ControlStatus`].
    pub status: i32,
    /// Newest tick of the process.
    pub tick: u64,
    /// The request's token.
    pub token: u64,
    /// Who answers, as `key=value` words; UTF-8, zero padded.
    pub text: [u8; 224],
}

assert_layout!(ControlRep, 256, {
    schema: 0, cmd: 8, abi: 10, status: 12, tick: 16, token: 24, text: 32,
});

impl ControlRep {
    /// Whether ABI and schema are those of this domain.
    pub fn fits(&self, schema: u64) -> bool {
        self.abi == ABI && self.schema == schema
    }

    /// The same with a text, of which 224 bytes are kept.
    pub fn with_text(mut self, text: &str) -> Self {
        for (to, from) in self.text.iter_mut().zip(text.bytes()) {
            *to = from;
        }
        self
    }

    /// The text, as far as it is one.
    pub fn text(&self) -> &str {
        text(&self.text)
    }
}

/// What stands before the padding, up to the first byte that is no text.
fn text(padded: &[u8]) -> &str {
    let bytes = padded.split(|&byte| byte == 0).next().unwrap_or_default();
    let valid = match core::str::from_utf8(bytes) {
        Ok(text) => return text,
        Err(error) => error.valid_up_to(),
    };
    bytes.get(..valid).and_then(|valid| core::str::from_utf8(valid).ok()).unwrap_or_default()
}
