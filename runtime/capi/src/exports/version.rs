//! Versions, and texts of errors.

use core::ffi::c_char;

use sortie_core::plan::VERSION;

use crate::errors::SortieError;

/// Major version of the library that this header belongs to.
pub const SORTIE_VERSION_MAJOR: u32 = 0;
/// Minor version of the library that this header belongs to.
pub const SORTIE_VERSION_MINOR: u32 = 1;
/// Patch version of the library that this header belongs to.
pub const SORTIE_VERSION_PATCH: u32 = 0;
/// Major version of the plans that the library reads.
pub const SORTIE_PLAN_FORMAT_MAJOR: u32 = 2;
/// Newest minor version of the plans that the library reads.
pub const SORTIE_PLAN_FORMAT_MINOR: u32 = 3;

/// The version of the library that runs: major << 16 | minor << 8 | patch. Compare it with `SORTIE_VERSION` of the header.
#[unsafe(no_mangle)]
pub extern "C" fn sortie_version() -> u32 {
    SORTIE_VERSION_MAJOR << 16 | SORTIE_VERSION_MINOR << 8 | SORTIE_VERSION_PATCH
}

/// The plan format that the library reads, and all older minor versions of it: major << 16 | minor.
#[unsafe(no_mangle)]
pub extern "C" fn sortie_plan_format() -> u32 {
    u32::from(VERSION.0) << 16 | u32::from(VERSION.1)
}

/// What is wrong and what to do, in one line that is never freed. For numbers that are no error too.
#[allow(unexpected_cfgs, reason = "`.ci/prove` alone sets it")]
#[unsafe(no_mangle)]
pub extern "C" fn sortie_error_text(error: i32) -> *const c_char {
    // The proof's negative control: an access that can panic.
    #[cfg(control)]
    let error = [error][error as usize];
    let text =
        SortieError::of(error).map_or(c"this number is no error of Sortie", SortieError::text);
    text.as_ptr()
}

#[cfg(test)]
mod tests {
    use std::format;

    use super::*;

    #[test]
    fn versions_are_those_of_the_crates() {
        let version =
            format!("{SORTIE_VERSION_MAJOR}.{SORTIE_VERSION_MINOR}.{SORTIE_VERSION_PATCH}");
        assert_eq!(version, env!("CARGO_PKG_VERSION"));
        let format = (u32::from(VERSION.0), u32::from(VERSION.1));
        assert_eq!(format, (SORTIE_PLAN_FORMAT_MAJOR, SORTIE_PLAN_FORMAT_MINOR));
    }
}
