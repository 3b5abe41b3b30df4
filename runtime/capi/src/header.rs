//! The header is what cbindgen makes of the sources.

use std::path::Path;
use std::vec::Vec;
use std::{env, fs};

/// The sources in the order in which the header has what they say.
const SOURCES: [&str; 9] = [
    "src/errors.rs",
    "src/policy.rs",
    "src/guards.rs",
    "src/exports/version.rs",
    "src/exports/load.rs",
    "src/exports/sizes.rs",
    "src/exports/robot.rs",
    "src/exports/decide.rs",
    "src/exports/guard.rs",
];

#[test]
fn the_header_is_made_of_the_sources() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config =
        cbindgen::Config::from_file(folder.join("cbindgen.toml")).expect("a configuration");
    let builder = cbindgen::Builder::new().with_config(config);
    let builder = SOURCES.iter().fold(builder, |builder, file| builder.with_src(folder.join(file)));
    let mut made = Vec::new();
    builder.generate().expect("sources that cbindgen reads").write(&mut made);
    let kept = folder.join("include/sortie.h");
    if fs::read(&kept).ok().as_ref() != Some(&made) {
        let made_at = env::temp_dir().join("sortie.h");
        fs::write(&made_at, made).expect("a folder for temporary files");
        panic!(
            "the header is another: look at it and take it over with `cp {} {}`",
            made_at.display(),
            kept.display()
        );
    }
}
