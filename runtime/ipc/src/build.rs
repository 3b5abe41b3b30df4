//! Which version of this crate a process runs, as its statuses say it.

/// This version: major, minor and patch in the upper byte, the next, and the lower half.
pub(crate) const BUILD: u32 = number(env!("CARGO_PKG_VERSION_MAJOR")) << 24
    | number(env!("CARGO_PKG_VERSION_MINOR")) << 16
    | number(env!("CARGO_PKG_VERSION_PATCH"));

const fn number(digits: &str) -> u32 {
    match u32::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => panic!("cargo writes versions in digits"),
    }
}

/// A version as people write it.
pub(crate) fn version(build: u32) -> String {
    format!("{}.{}.{}", build >> 24, build >> 16 & 0xFF, build & 0xFFFF)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_comes_back() {
        assert_eq!(version(BUILD), env!("CARGO_PKG_VERSION"));
    }
}
