//! Names of types, topics and nodes, and how they stand in keys.

use std::fmt;

/// Most letters of a name: ROS has 255 for topics, and no key becomes too long for a line of the network.
const MOST_LETTERS: usize = 255;

/// Why a name is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NameError {
    /// Not `package/msg/Name`.
    #[error("`{0}` is no type; types are `package/msg/Name`")]
    Type(String),
    /// Not `/agent_3/action`.
    #[error(
        "`{0}` is no topic; topics are `/` and words of letters, digits and `_` with `/` between, none of which begins with a digit"
    )]
    Topic(String),
    /// Not `/team`, or `/` for none.
    #[error("`{0}` is no namespace; namespaces are `/`, or `/` and words as topics have")]
    Namespace(String),
    /// Not `sortie_bridge`.
    #[error(
        "`{0}` is no name of a node; those are letters, digits and `_`, and do not begin with a digit"
    )]
    Node(String),
    /// Not what zenoh calls a session.
    #[error("`{0}` is no session; zenoh's are 1 to 32 lower-case hexadecimal digits")]
    Session(String),
}

/// The name of a type, `std_msgs/msg/String`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TypeName(String);

impl TypeName {
    /// Of its name in ROS.
    ///
    /// # Errors
    /// [`NameError::Type`].
    pub fn new(name: &str) -> Result<Self, NameError> {
        let parts: Vec<&str> = name.split('/').collect();
        let is_name = match *parts {
            [package, kind, name] => {
                is_word(package) && matches!(kind, "msg" | "srv" | "action") && is_word(name)
            }
            _ => false,
        };
        if is_name { Ok(Self(name.to_owned())) } else { Err(NameError::Type(name.to_owned())) }
    }

    /// Of its name in keys, which is that of DDS: `std_msgs::msg::dds_::String_`.
    ///
    /// # Errors
    /// [`NameError::Type`].
    pub fn of_dds(dds: &str) -> Result<Self, NameError> {
        let parts: Vec<&str> = dds.split("::").collect();
        let wrong = || NameError::Type(dds.to_owned());
        let [package, kind, "dds_", name] = *parts else { return Err(wrong()) };
        let name = name.strip_suffix('_').ok_or_else(wrong)?;
        Self::new(&format!("{package}/{kind}/{name}")).map_err(|_| wrong())
    }

    /// Its name in keys.
    ///
    /// ```
    /// let name = sortie_ros2::TypeName::new("std_msgs/msg/String")?;
    /// assert_eq!(name.dds(), "std_msgs::msg::dds_::String_");
    /// # Ok::<(), sortie_ros2::NameError>(())
    /// ```
    pub fn dds(&self) -> String {
        let (before, name) = self.0.rsplit_once('/').unwrap_or_default();
        format!("{}::dds_::{name}_", before.replace('/', "::"))
    }

    /// Its name in ROS.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The package that it is of.
    pub fn package(&self) -> &str {
        self.0.split('/').next().unwrap_or_default()
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A word of a name.
pub(crate) fn is_word(word: &str) -> bool {
    let begins = |first: char| first.is_ascii_alphabetic() || first == '_';
    word.len() <= MOST_LETTERS
        && word.starts_with(begins)
        && word.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
}

fn is_path(path: &str) -> bool {
    let words = path.strip_prefix('/');
    path.len() <= MOST_LETTERS && words.is_some_and(|words| words.split('/').all(is_word))
}

/// Whether a whole name is one of a topic: nothing in it means anything to zenoh.
pub(crate) fn check_topic(topic: &str) -> Result<(), NameError> {
    if is_path(topic) { Ok(()) } else { Err(NameError::Topic(topic.to_owned())) }
}

pub(crate) fn check_namespace(namespace: &str) -> Result<(), NameError> {
    if namespace == "/" || is_path(namespace) {
        return Ok(());
    }
    Err(NameError::Namespace(namespace.to_owned()))
}

pub(crate) fn check_node(node: &str) -> Result<(), NameError> {
    if is_word(node) { Ok(()) } else { Err(NameError::Node(node.to_owned())) }
}

pub(crate) fn check_session(session: &str) -> Result<(), NameError> {
    let is_digit = |digit: u8| digit.is_ascii_digit() || (b'a'..=b'f').contains(&digit);
    if (1..=32).contains(&session.len()) && session.bytes().all(is_digit) {
        return Ok(());
    }
    Err(NameError::Session(session.to_owned()))
}

/// A name as one part of a key: none of its `/` divides the key.
pub(crate) fn mangle(name: &str) -> String {
    name.replace('/', "%")
}

/// The name of a part of a key.
pub(crate) fn unmangle(part: &str) -> String {
    part.replace('%', "/")
}
