//! A node: what it says of itself, and its publishers and subscriptions.

use crate::attachment::Attachment;
use crate::cdr::{CdrError, encode};
use crate::definition::{DefinitionError, Release};
use crate::messages::Message;
use crate::names::{self, NameError, TypeName};
use crate::qos::Qos;
use crate::token::{Kind, Token, Topic};

/// What carries keys and bytes: a session of zenoh, or whatever a test has.
///
/// Nobody waits for those who read: a carrier that cannot pass a message on drops it.
pub trait Carrier {
    /// What fails.
    type Error: std::error::Error + Send + Sync + 'static;

    /// Says that whoever has this token is there, until the carrier ends; of a subscription, once it hears.
    ///
    /// # Errors
    /// The session is closed, or takes no such key.
    fn declare(&mut self, token: &str) -> Result<(), Self::Error>;

    /// Publishes bytes with their attachment to a key.
    ///
    /// # Errors
    /// The session is closed. That nobody reads is none.
    fn put(&mut self, key: &str, bytes: &[u8], attachment: &[u8]) -> Result<(), Self::Error>;

    /// Whether somebody may read this key: what nobody reads is not even written. Yes, where it is not known.
    fn is_read(&mut self, key: &str) -> bool {
        let _ = key;
        true
    }
}

/// What fails where messages are published.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BridgeError<E: std::error::Error + 'static> {
    /// A topic is none, or the definition of a message.
    #[error(transparent)]
    Definition(#[from] DefinitionError),
    /// A message cannot be written.
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// The carrier failed.
    #[error("zenoh: {0}")]
    Carrier(#[source] E),
}

/// A node of ROS.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node {
    release: Release,
    token: Token,
}

impl Node {
    /// A node of a session of zenoh, in ROS's `domain` (`ROS_DOMAIN_ID`, 0 unless it is said). A session has one such node.
    ///
    /// # Errors
    /// [`NameError`]: the session, the namespace or the name is none.
    ///
    /// ```
    /// use sortie_ros2::{Node, Release};
    ///
    /// let node = Node::new(0, "9ca0f8fa", "/team", "sortie_bridge", Release::Jazzy)?;
    /// assert_eq!(node.token().to_string(), "@ros2_lv/0/9ca0f8fa/0/0/NN/%/%team/sortie_bridge");
    /// assert_eq!(node.topic("agent_3/action"), "/team/agent_3/action");
    /// # Ok::<(), sortie_ros2::NameError>(())
    /// ```
    pub fn new(
        domain: u32,
        session: &str,
        namespace: &str,
        name: &str,
        release: Release,
    ) -> Result<Self, NameError> {
        names::check_session(session)?;
        names::check_namespace(namespace)?;
        names::check_node(name)?;
        let token = Token {
            domain,
            session: session.to_owned(),
            node: 0,
            entity: 0,
            kind: Kind::Node,
            enclave: "/".to_owned(),
            namespace: namespace.to_owned(),
            name: name.to_owned(),
            topic: None,
        };
        Ok(Self { release, token })
    }

    /// Its token.
    pub fn token(&self) -> &Token {
        &self.token
    }

    /// The whole name of a topic in its namespace.
    pub fn topic(&self, name: &str) -> String {
        format!("{}/{name}", self.token.namespace.trim_end_matches('/'))
    }

    /// What publishes messages to a topic of its namespace. Numbers of publishers and subscriptions, from 1, are the node's
    /// to give: no two have the same.
    ///
    /// # Errors
    /// [`DefinitionError::Name`]; for messages of this crate there is no other.
    pub fn publisher<M: Message>(
        &self,
        number: u64,
        topic: &str,
        qos: Qos,
    ) -> Result<Publisher, DefinitionError> {
        let (token, key) = self.end::<M>(Kind::Publisher, number, topic, qos)?;
        let gid = token.gid();
        Ok(Publisher { name: M::NAME, token, key, gid, sequence: 0, bytes: Vec::new() })
    }

    /// What reads messages of a topic: its token, and the key to subscribe to.
    ///
    /// # Errors
    /// As [`Self::publisher`].
    pub fn subscription<M: Message>(
        &self,
        number: u64,
        topic: &str,
        qos: Qos,
    ) -> Result<(Token, String), DefinitionError> {
        self.end::<M>(Kind::Subscription, number, topic, qos)
    }

    fn end<M: Message>(
        &self,
        kind: Kind,
        entity: u64,
        topic: &str,
        qos: Qos,
    ) -> Result<(Token, String), DefinitionError> {
        let name = self.topic(topic);
        names::check_topic(&name)?;
        let hash = self.release.hash_of::<M>()?;
        let topic = Topic { name, type_name: TypeName::new(M::NAME)?, hash, qos };
        let key = topic.key(self.token.domain);
        Ok((Token { kind, entity, topic: Some(topic), ..self.token.clone() }, key))
    }
}

/// What publishes messages of one type to one topic.
#[derive(Debug)]
pub struct Publisher {
    name: &'static str,
    token: Token,
    key: String,
    gid: [u8; 16],
    sequence: i64,
    bytes: Vec<u8>,
}

impl Publisher {
    /// Its token.
    pub fn token(&self) -> &Token {
        &self.token
    }

    /// The key that it publishes to.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Publishes a message that was sent at `source_ns` since 1970.
    ///
    /// # Errors
    /// [`BridgeError::Cdr`], [`BridgeError::Carrier`].
    pub fn publish<M: Message, C: Carrier>(
        &mut self,
        carrier: &mut C,
        message: &M,
        source_ns: u64,
    ) -> Result<(), BridgeError<C::Error>> {
        debug_assert_eq!(M::NAME, self.name, "a publisher has one type");
        encode(message, &mut self.bytes)?;
        self.sequence = self.sequence.wrapping_add(1);
        let source_ns = i64::try_from(source_ns).unwrap_or(i64::MAX);
        let attachment = Attachment { sequence: self.sequence, source_ns, gid: self.gid };
        let put = carrier.put(&self.key, &self.bytes, &attachment.to_bytes());
        put.map_err(BridgeError::Carrier)
    }
}
