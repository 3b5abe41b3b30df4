//! How a session of zenoh is set up for a line that ticks.

use std::path::{Path, PathBuf};

use zenoh::Config;

/// What every session gets, whatever a file says: zenoh's own times are seconds, a team's are milliseconds.
const SETTINGS: [(&str, &str); 11] = [
    // Who says nothing for so long is gone: a socket of TCP keeps what was said into a cut, and a connection that is given up
    // takes it along.
    ("transport/link/tx/lease", "400"),
    ("transport/link/tx/keep_alive", "4"),
    // And is looked for again at once.
    ("connect/retry", "{ period_init_ms: 100, period_max_ms: 100, period_increase_factor: 1 }"),
    ("listen/retry", "{ period_init_ms: 100, period_max_ms: 100, period_increase_factor: 1 }"),
    // An opening that got lost is not waited for: over UDP nobody repeats it.
    ("transport/unicast/open_timeout", "300"),
    // Who cannot send does not wait: the frame is late anyway, and a world would wait with it.
    ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", "0"),
    ("transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments", "0"),
    // But there is room for a frame in pieces, and for last words that are said several times.
    ("transport/link/tx/queue/size/real_time", "16"),
    // With one queue for all priorities, lines of a thousand frames a second were cut and did not come back; the mode of low
    // latency stalls.
    ("transport/unicast/lowlatency", "false"),
    ("transport/unicast/qos/enabled", "true"),
    // Not compiled in, and shut where a later version compiles it: containers share /dev/shm, and are other hosts.
    ("transport/shared_memory/enabled", "false"),
];

/// Which end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The team's, which listens.
    Home,
    /// The runner's, which goes there.
    Away,
}

/// What one end of a line is opened with.
#[derive(Clone, Copy, Debug)]
pub struct ZenohSettings<'a> {
    /// Which it is.
    pub end: End,
    /// Where the team's end listens and the runner's goes, as zenoh writes it; none: the configuration says.
    pub locator: Option<&'a str>,
    /// A file of zenoh's own, JSON5 or YAML: for TLS, access, routers.
    pub configuration: Option<&'a Path>,
    /// What tells this line from others at one router: a part of zenoh's keys.
    pub line: &'a str,
}

/// Why an end is not opened.
#[derive(Debug, thiserror::Error)]
pub enum ZenohError {
    /// The file is no configuration of zenoh.
    #[error("{}: no configuration of zenoh: {reason}", file.display())]
    Configuration {
        /// The file.
        file: PathBuf,
        /// What zenoh says.
        reason: String,
    },
    /// The locator, or the line's name, is none of zenoh's.
    #[error("zenoh takes no `{value}`: {reason}")]
    Setting {
        /// What was to be set.
        value: String,
        /// What zenoh says.
        reason: String,
    },
    /// There is no session.
    #[error("zenoh opens no session at {address}: {reason}")]
    Session {
        /// Where it listens or goes.
        address: String,
        /// What zenoh says.
        reason: String,
    },
}

impl ZenohSettings<'_> {
    /// Where it goes, in words for a person.
    pub(crate) fn address(&self) -> String {
        match (self.locator, self.configuration) {
            (Some(locator), _) => format!("zenoh/{locator}"),
            (None, Some(file)) => format!("zenoh as {} says", file.display()),
            (None, None) => "zenoh".to_owned(),
        }
    }

    /// The key under which one end says something.
    pub(crate) fn key(&self, speaker: End) -> String {
        let speaker = match speaker {
            End::Home => "home",
            End::Away => "away",
        };
        format!("sortie/{}/{speaker}", self.line)
    }

    /// The file's configuration with what this end needs. Where a locator is named it is the only one, and nobody is looked for.
    pub(crate) fn configuration(&self) -> Result<Config, ZenohError> {
        let mut configuration = read_configuration(self.configuration)?;
        let mut set = |key: &str, value: &str| {
            configuration.insert_json5(key, value).map_err(|error| ZenohError::Setting {
                value: value.to_owned(),
                reason: error.to_string(),
            })
        };
        SETTINGS.into_iter().try_for_each(|(key, value)| set(key, value))?;
        if let Some(locator) = self.locator {
            let only = format!("[{locator:?}]");
            let (listen, connect) = match self.end {
                End::Home => (only.as_str(), "[]"),
                End::Away => ("[]", only.as_str()),
            };
            set("listen/endpoints", listen)?;
            set("connect/endpoints", connect)?;
            set("scouting/multicast/enabled", "false")?;
        }
        Ok(configuration)
    }
}

/// A file of zenoh's own, JSON5 or YAML; without one zenoh's defaults.
///
/// # Errors
/// [`ZenohError::Configuration`].
pub fn read_configuration(file: Option<&Path>) -> Result<Config, ZenohError> {
    let Some(file) = file else { return Ok(Config::default()) };
    Config::from_file(file).map_err(|error| ZenohError::Configuration {
        file: file.to_owned(),
        reason: error.to_string(),
    })
}
