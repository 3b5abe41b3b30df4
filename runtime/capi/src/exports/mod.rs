//! The functions of the header, by what they are about.

pub(crate) mod decide;
pub(crate) mod guard;
pub(crate) mod load;
pub(crate) mod robot;
pub(crate) mod sizes;
pub(crate) mod version;
