//! The pages about the keys of methods say what the program knows.

use sortie_learn::run::Difference;
use sortie_methods::value_factorisation::{QMIX, REFIL, VDN};

const HEAD: &str = "\
# Methods of any environment, key by key

`sortie train METHOD --env ENV/SET --print-config` prints these keys with their values; `--set`, `--config` and `train.toml` take them, as
[configuration.md](configuration.md) says. This page is written by the program; a test compares them.
";

#[test]
fn the_page_lists_every_key() {
    let mut page = HEAD.to_owned() + &QMIX.reference().unwrap() + "\n## The others\n\n";
    for preset in ["fast", "paper"] {
        let qmix = QMIX.preset(preset).unwrap();
        for other in [VDN, REFIL] {
            let setup = other.preset(preset).unwrap();
            let Difference { key, theirs, .. } =
                Difference::between(&qmix, &setup).unwrap().unwrap();
            page += &format!("- `{}`, preset `{preset}`: `{key}` is `{theirs}`.\n", other.name);
        }
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/configuration-methods.md");
    if std::env::var_os("SORTIE_WRITE_DOCS").is_some() {
        std::fs::write(path, &page).unwrap();
    }
    assert!(
        std::fs::read_to_string(path).unwrap_or_default() == page,
        "docs/configuration-methods.md is another: SORTIE_WRITE_DOCS=1 cargo test -p sortie-methods --test reference"
    );
}

#[test]
fn the_page_of_almas_keys_is_as_the_program_writes_it() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/configuration.md");
    let page = sortie_methods::alma::reference().unwrap();
    if std::env::var_os("SORTIE_WRITE_DOCS").is_some() {
        std::fs::write(path, &page).unwrap();
    }
    assert!(
        std::fs::read_to_string(path).unwrap_or_default() == page,
        "docs/configuration.md is another: SORTIE_WRITE_DOCS=1 cargo test -p sortie-methods --test reference"
    );
}
