//! Letters for things that have no names.

use alloc::format;
use alloc::string::{String, ToString};

/// `A` for the first of some things, `A2` for the one after `Z`.
pub fn lettered(number: usize) -> String {
    let letter = char::from(b'A' + (number % 26) as u8);
    match number / 26 {
        0 => letter.to_string(),
        round => format!("{letter}{}", round + 1),
    }
}
