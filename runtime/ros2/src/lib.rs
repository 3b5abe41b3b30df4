//! A team and a policy as nodes of ROS 2, for hosts that speak zenoh (`rmw_zenoh`), without ROS and without zenoh.
//!
//! This crate knows the keys, tokens, attachments and bytes; a [`Carrier`] has the session. Keys, tokens and attachments are
//! held to those of a real publisher, bit for bit.
//!
//! A node that publishes a text:
//!
//! ```
//! use std::convert::Infallible;
//!
//! use sortie_ros2::{Attachment, Carrier, Node, Qos, Release, decode, messages::Text};
//!
//! /// In place of a session.
//! #[derive(Default)]
//! struct Kept(Vec<(String, Vec<u8>, Vec<u8>)>);
//!
//! impl Carrier for Kept {
//!     type Error = Infallible;
//!     fn declare(&mut self, _token: &str) -> Result<(), Infallible> {
//!         Ok(())
//!     }
//!     fn put(&mut self, key: &str, bytes: &[u8], attachment: &[u8]) -> Result<(), Infallible> {
//!         self.0.push((key.to_owned(), bytes.to_vec(), attachment.to_vec()));
//!         Ok(())
//!     }
//! }
//!
//! let mut carrier = Kept::default();
//! let node = Node::new(0, "9ca0f8fa", "/", "talker", Release::Humble)?;
//! let mut chatter = node.publisher::<Text>(1, "chatter", Qos::TOPIC)?;
//! carrier.declare(&node.token().to_string())?;
//! carrier.declare(&chatter.token().to_string())?;
//! chatter.publish(&mut carrier, &Text { data: "hello".to_owned() }, 1_700_000_000_000_000_000)?;
//!
//! let (key, bytes, attachment) = &carrier.0[0];
//! assert_eq!(key, "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported");
//! assert_eq!(decode::<Text>(bytes)?.data, "hello");
//! assert_eq!(Attachment::from_bytes(attachment)?.sequence, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | for | see |
//! | --- | --- |
//! | what a running team says, as topics | [`TeamBridge`] |
//! | a policy that reads observations and publishes actions | [`PolicyNode`] |
//! | who else is there | [`Token::parse`] |
//! | messages of one's own | [`messages::Message`], [`Definition`], [`TypeHash`] |

mod attachment;
mod cdr;
mod convert;
mod definition;
pub mod messages;
mod names;
mod node;
mod policy;
mod qos;
mod team;
mod token;

pub use attachment::{ATTACHMENT_BYTES, Attachment, AttachmentError};
pub use cdr::{CdrError, decode, encode};
pub use definition::{Definition, DefinitionError, Field, Release, TypeHash};
pub use names::{NameError, TypeName};
pub use node::{BridgeError, Carrier, Node, Publisher};
pub use policy::{Answer, ObservationError, Observed, PolicyFacts, PolicyNode};
pub use qos::{Durability, History, Liveliness, Qos, QosError, Reliability, Span};
pub use team::{Bridged, TeamBridge, TeamFacts};
pub use token::{Kind, Token, TokenError, Topic};
