//! The line between two hosts: what both ends are told of it. It goes over UDP, or through zenoh.

use std::fmt;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::process::Command;
use std::str::FromStr;
use std::sync::Arc;

use clap::Args;
use sortie_line::{Key, KeyError, LineSettings, Udp};

use crate::failure::{Exit, Failure, Outcome};
use crate::output::tell;
use crate::zenoh::{self, LineThrough};

/// What an address through zenoh begins with.
const ZENOH: &str = "zenoh";

/// Where a line goes, or where a team listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// A host and its port.
    Udp(String),
    /// A locator of zenoh, or none, where its configuration says.
    Zenoh(Option<String>),
}

impl Place {
    /// Where a team listens if nobody says: nobody else than this host reaches it.
    pub(crate) fn loopback() -> Self {
        Self::Udp("127.0.0.1:7447".to_owned())
    }
}

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once('/') {
            None if text == ZENOH => Ok(Self::Zenoh(None)),
            None => Ok(Self::Udp(text.to_owned())),
            Some((ZENOH, locator)) => match locator.split_once('/') {
                Some((protocol, address)) if !protocol.is_empty() && !address.is_empty() => {
                    Ok(Self::Zenoh(Some(locator.to_owned())))
                }
                _ => Err(format!(
                    "`{locator}` is no locator of zenoh: `tcp/192.168.1.5:7447` is one"
                )),
            },
            Some(_) => Err("it is neither HOST:PORT nor `zenoh/` and a locator".to_owned()),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Udp(address) => f.write_str(address),
            Self::Zenoh(None) => f.write_str(ZENOH),
            Self::Zenoh(Some(locator)) => write!(f, "{ZENOH}/{locator}"),
        }
    }
}

/// One end of a line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineEnd<'a> {
    /// Whether it is the team's.
    pub(crate) is_home: bool,
    pub(crate) place: &'a Place,
    pub(crate) domain: &'a str,
    pub(crate) agents: &'a [u16],
}

/// What both ends of a line have to be told.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct LineArguments {
    /// File with the secret of both hosts; `sortie up` makes it where it is missing
    #[arg(long, value_name = "FILE", conflicts_with = "plain")]
    key: Option<PathBuf>,
    /// Without a secret: whoever reaches the address may act for the agents
    #[arg(long)]
    plain: bool,
    /// Say everything twice, for a line that loses datagrams
    #[arg(long)]
    twice: bool,
    /// Through zenoh: its own configuration, for TLS, access and routers
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

impl LineArguments {
    /// The secret that was named, or none where none is wanted.
    fn key(&self) -> Result<Key, Failure> {
        match &self.key {
            Some(file) => Key::read(file).map_err(unusable),
            None if self.plain => Ok(Key::plain()),
            None => Err(Failure::new(
                Exit::Usage,
                "a line has a secret: name its file by --key, or do without by --plain",
            )),
        }
    }

    /// The same; a secret that is missing is made.
    pub(crate) fn key_or_new(&self) -> Result<Key, Failure> {
        if let Some(file) = self.key.as_deref().filter(|file| !file.exists()) {
            Key::create(file).map_err(unusable)?;
            tell!("{} is a new secret: the other host needs a copy of it", file.display());
        }
        self.key()
    }

    /// What this end is opened with.
    pub(crate) fn settings(&self, end: &LineEnd<'_>) -> Result<LineSettings, Failure> {
        let LineEnd { is_home, place, domain, agents } = *end;
        let key = self.key()?;
        let carrier = match place {
            Place::Udp(address) => {
                let address = resolve(address)?;
                let udp = if is_home { Udp::listen(address) } else { Udp::connect(address) };
                Arc::new(udp.map_err(sortie_ipc::Error::from)?)
            }
            Place::Zenoh(locator) => {
                let (locator, configuration) = (locator.as_deref(), self.config.as_deref());
                zenoh::linked()?.line(&LineThrough {
                    is_home,
                    locator,
                    configuration,
                    domain,
                    agents,
                })?
            }
        };
        Ok(LineSettings { carrier, key, copies: if self.twice { 2 } else { 1 } })
    }

    /// Fails early where neither this program nor the one beside it can carry such a line.
    pub(crate) fn check(&self, place: &Place) -> Outcome {
        match (place, &self.config) {
            (Place::Udp(_), Some(_)) => Err(Failure::new(
                Exit::Usage,
                "--config is zenoh's: it goes with an address that begins with `zenoh`",
            )),
            (Place::Zenoh(None), None) => Err(Failure::new(
                Exit::Usage,
                "where does zenoh listen or go to? Name it, `zenoh/tcp/192.168.1.5:7447`, or a file that says so by --config",
            )),
            (Place::Udp(address), None) => resolve(address).map(drop),
            (Place::Zenoh(_), _) => zenoh::check(),
        }
    }

    /// As flags for another process.
    pub(crate) fn put(&self, command: &mut Command) {
        for (flag, file) in [("--key", &self.key), ("--config", &self.config)] {
            if let Some(file) = file {
                command.arg(flag).arg(file);
            }
        }
        for (flag, is_set) in [("--plain", self.plain), ("--twice", self.twice)] {
            if is_set {
                command.arg(flag);
            }
        }
    }
}

fn unusable(error: KeyError) -> Failure {
    let exit = match error {
        KeyError::File { .. } => Exit::Missing,
        KeyError::Readable { .. } => Exit::NotPermitted,
        KeyError::Short { .. } => Exit::BadData,
    };
    Failure::new(exit, error.to_string())
}

fn resolve(address: &str) -> Result<SocketAddr, Failure> {
    let unknown = |why: String| {
        let message = format!("`{address}` is no address of a host and its port: {why}");
        Failure::new(Exit::Usage, message)
    };
    let mut found = address.to_socket_addrs().map_err(|error| unknown(error.to_string()))?;
    found.next().ok_or_else(|| unknown("nobody has it".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_read_as_they_are_written() {
        for (text, place) in [
            ("host:7447", Place::Udp("host:7447".to_owned())),
            ("[::1]:7447", Place::Udp("[::1]:7447".to_owned())),
            ("zenoh", Place::Zenoh(None)),
            ("zenoh/tls/host:7447", Place::Zenoh(Some("tls/host:7447".to_owned()))),
        ] {
            assert_eq!(text.parse(), Ok(place.clone()));
            assert_eq!(place.to_string(), text);
        }
        for text in ["tcp/host:7447", "zenoh/", "zenoh/tcp", "zenoh/host:7447", "zenoh/tcp/"] {
            assert!(text.parse::<Place>().is_err(), "{text}");
        }
    }
}
