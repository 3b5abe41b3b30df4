//! The page of the documentation that the program writes.

use std::fs;
use std::path::Path;

#[test]
fn the_page_of_all_keys_is_as_the_program_writes_it() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/configuration.md");
    let page = sortie_learn::configuration::reference().unwrap();
    if std::env::var_os("SORTIE_WRITE_DOCS").is_some() {
        fs::write(&path, &page).unwrap();
    }
    assert!(
        fs::read_to_string(&path).unwrap_or_default() == page,
        "docs/configuration.md is another: SORTIE_WRITE_DOCS=1 cargo test -p sortie-learn --test reference"
    );
}
