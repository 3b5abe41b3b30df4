//! Liveliness tokens: how nodes, publishers and subscriptions tell that they are there.
//!
//! A token is a key: `@ros2_lv/<domain>/<session>/<node>/<entity>/<kind>/<enclave>/<namespace>/<name>`, and for what is more
//! than a node `/<topic>/<type>/<hash>/<quality of service>`. A `/` within a part is written `%`.

use std::fmt;

use twox_hash::XxHash3_128;

use crate::definition::TypeHash;
use crate::names::{self, NameError, TypeName, mangle, unmangle};
use crate::qos::{Qos, QosError};

/// What all tokens begin with.
const SPACE: &str = "@ros2_lv";
/// Longer ones than any that names permit are not looked at.
const MOST_LETTERS: usize = 4096;

/// Why a key is no token.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TokenError {
    /// More letters than any token has.
    #[error("it has {0} letters, more than any token")]
    Long(usize),
    /// A part is missing, is no number or of no known kind, or there is one more.
    #[error("its {0} is missing or none")]
    Part(&'static str),
    /// A part is no name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Its quality of service is none.
    #[error(transparent)]
    Qos(#[from] QosError),
}

/// What there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A node.
    Node,
    /// Somebody who publishes to a topic.
    Publisher,
    /// Somebody who reads a topic.
    Subscription,
    /// Somebody who answers.
    Service,
    /// Somebody who asks.
    Client,
}

impl Kind {
    const ALL: [Self; 5] =
        [Self::Node, Self::Publisher, Self::Subscription, Self::Service, Self::Client];

    /// As it is written.
    pub fn letters(self) -> &'static str {
        match self {
            Self::Node => "NN",
            Self::Publisher => "MP",
            Self::Subscription => "MS",
            Self::Service => "SS",
            Self::Client => "SC",
        }
    }
}

/// A topic, what crosses over it, and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Its whole name, `/agent_3/action`.
    pub name: String,
    /// What its messages are.
    pub type_name: TypeName,
    /// The hash of that.
    pub hash: TypeHash,
    /// How they are treated.
    pub qos: Qos,
}

impl Topic {
    /// The key that its messages are published to.
    pub fn key(&self, domain: u32) -> String {
        let Self { name, type_name, hash, .. } = self;
        format!("{domain}/{}/{}/{hash}", name.trim_start_matches('/'), type_name.dds())
    }
}

/// Somebody who is there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// ROS's domain, `ROS_DOMAIN_ID`.
    pub domain: u32,
    /// The session of zenoh.
    pub session: String,
    /// Number of the node in its session.
    pub node: u64,
    /// Number of this one in its session; a node's own is that of the node.
    pub entity: u64,
    /// What it is.
    pub kind: Kind,
    /// What its rights are kept by, `/` where there are none.
    pub enclave: String,
    /// The node's namespace, `/` where there is none.
    pub namespace: String,
    /// The node's name.
    pub name: String,
    /// Of what is more than a node.
    pub topic: Option<Topic>,
}

impl Token {
    /// Of a key.
    ///
    /// # Errors
    /// See [`TokenError`].
    ///
    /// ```
    /// use sortie_ros2::{Kind, Token};
    ///
    /// let key = "@ros2_lv/0/9ca0/0/3/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported/::,7:,:,:,,";
    /// let token = Token::parse(key)?;
    /// assert_eq!((token.kind, token.name.as_str()), (Kind::Publisher, "talker"));
    /// assert_eq!(token.topic.as_ref().map(|topic| topic.qos.depth), Some(7));
    /// assert_eq!(token.to_string(), key);
    /// # Ok::<(), sortie_ros2::TokenError>(())
    /// ```
    pub fn parse(key: &str) -> Result<Self, TokenError> {
        if key.len() > MOST_LETTERS {
            return Err(TokenError::Long(key.len()));
        }
        let mut parts = key.split('/');
        let mut part = |name| parts.next().ok_or(TokenError::Part(name));
        if part("space")? != SPACE {
            return Err(TokenError::Part("space"));
        }
        let domain = number(part("domain")?).ok_or(TokenError::Part("domain"))?;
        let session = part("session")?;
        names::check_session(session)?;
        let node = number(part("number of the node")?).ok_or(TokenError::Part("node"))?;
        let entity = number(part("number")?).ok_or(TokenError::Part("number"))?;
        let letters = part("kind")?;
        let kind = Kind::ALL.into_iter().find(|kind| kind.letters() == letters);
        let kind = kind.ok_or(TokenError::Part("kind"))?;
        let enclave = unmangle(part("enclave")?);
        names::check_namespace(&enclave)?;
        let namespace = unmangle(part("namespace")?);
        names::check_namespace(&namespace)?;
        let name = part("name")?;
        names::check_node(name)?;
        let topic = match kind {
            Kind::Node => None,
            _ => Some(topic(&mut part)?),
        };
        if parts.next().is_some() {
            return Err(TokenError::Part("end"));
        }
        let (session, name) = (session.to_owned(), name.to_owned());
        Ok(Self { domain, session, node, entity, kind, enclave, namespace, name, topic })
    }

    /// The id of whoever has this token, which stands in attachments: XXH3 of it, the lower half first.
    pub fn gid(&self) -> [u8; 16] {
        XxHash3_128::oneshot(self.to_string().as_bytes()).to_le_bytes()
    }
}

fn topic<'a>(
    part: &mut dyn FnMut(&'static str) -> Result<&'a str, TokenError>,
) -> Result<Topic, TokenError> {
    let name = unmangle(part("topic")?);
    names::check_topic(&name)?;
    let type_name = TypeName::of_dds(part("type")?)?;
    let hash = TypeHash::parse(part("hash")?).ok_or(TokenError::Part("hash"))?;
    let qos = Qos::parse(part("quality of service")?)?;
    Ok(Topic { name, type_name, hash, qos })
}

fn number<T: std::str::FromStr>(text: &str) -> Option<T> {
    // No sign, which the language's own parser would take.
    text.bytes().all(|digit| digit.is_ascii_digit()).then(|| text.parse().ok())?
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { domain, session, node, entity, kind, enclave, namespace, name, topic } = self;
        write!(f, "{SPACE}/{domain}/{session}/{node}/{entity}/{}/", kind.letters())?;
        write!(f, "{}/{}/{name}", mangle(enclave), mangle(namespace))?;
        let Some(Topic { name, type_name, hash, qos }) = topic else { return Ok(()) };
        write!(f, "/{}/{}/{hash}/{qos}", mangle(name), type_name.dds())
    }
}
