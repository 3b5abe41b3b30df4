//! zenoh as what carries the line between two hosts, and the program `sortie-zenoh`, which is Sortie's command line with it.
//!
//! [`ZenohCarrier`] is a [`Carrier`](sortie_line::Carrier): what [`Home`](sortie_line::Home) and [`Away`](sortie_line::Away) say goes
//! through a session of zenoh, over TCP, UDP or TLS, directly or through routers, as locators and zenoh's own configuration say.
//! Session, number and checksum of the line stay above it: who has the key acts, whoever a router lets in.
//!
//! ```
//! use std::sync::Arc;
//! use std::time::Duration;
//!
//! use sortie_line::Carrier;
//! use sortie_zenoh::{End, ZenohCarrier, ZenohSettings};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let open = |end| {
//!     let line = "default/3,4";
//!     ZenohCarrier::open(&ZenohSettings { end, locator: Some("tcp/127.0.0.1:17441"), configuration: None, line })
//! };
//! let (home, away) = (open(End::Home)?, open(End::Away)?);
//! let mut room = [0; 16];
//! let heard = loop {
//!     // Lost until they have found each other.
//!     away.send(b"hello", None);
//!     home.wait(Duration::from_millis(20));
//!     if let Some((len, _)) = home.receive(&mut room) {
//!         break len;
//!     }
//! };
//! assert_eq!(room.get(..heard), Some(&b"hello"[..]));
//! # Ok(())
//! # }
//! ```

mod carrier;
mod configuration;

pub use carrier::ZenohCarrier;
pub use configuration::{End, ZenohError, ZenohSettings, read_configuration};
