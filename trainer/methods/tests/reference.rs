//! The page about the keys of methods says what the program knows.

use std::fmt::Write as _;

use sortie_envs::registry::Setting;
use sortie_envs::{ENVIRONMENTS, Split};
use sortie_learn::run::Difference;
use sortie_learn::session::MethodEntry;
use sortie_methods::alma::{ALMA, COPA, FLAT};
use sortie_methods::dqn::DQN;
use sortie_methods::hal::{H_DQN, HAL, HAL_ORACLE};
use sortie_methods::ma_exp::MA_EXP;
use sortie_methods::maac::{COMA, COMA_SAC, DDPG, MAAC, MADDPG, MADDPG_SAC};
use sortie_methods::value_factorisation::{QMIX, REFIL, VDN};

const HEAD: &str = "\
# The configuration, key by key

`sortie train METHOD --print-config` prints the configuration that a command would learn by, with all of this as comments; it
takes `--env`, `--preset`, `--config`, `--set` and the other flags. What it prints is a file for `--config`, which may leave out what it
does not change. `--set replay.batch=256` changes one value. A value outside its range, or a key that does not exist, is
refused with exit code 2, by key, value and range, in files also by line. `train.toml` in a run's folder holds the values
that the run learns by; `sortie train METHOD --resume DIR --steps N` changes `run.steps` and nothing else.

`--mixer M`, `--no-mask` and `--allocation RULE` are short for `--set` of the keys that they are about.

`environment.settings` holds numbers of the rules: `--set environment.settings.episode_limit=100`. Which there are is up to the
environment, see [environments.md](environments.md#settings).

In the preset `fast` of `alma` and `flat`, runs of less than 600,000 steps shrink `exploration.steps`, `allocator.learns_from` and
`allocator.decides_from` in proportion, unless they are set.

This page is written by the program; a test compares them.
";

/// What methods have otherwise than a first one.
fn others(first: &MethodEntry, others: &[MethodEntry]) -> String {
    let names: Vec<&str> = others.iter().map(|other| other.name).collect();
    let mut text = format!("\n## `{}`\n\nAs `{}` but for:\n\n", names.join("` and `"), first.name);
    for other in others {
        for preset in other.presets {
            let setup = other.preset(preset.name).unwrap();
            // The preset of the first that is most like it.
            let presets = first.presets.iter().map(|preset| first.preset(preset.name).unwrap());
            let apart = presets.map(|usual| Difference::between(&usual, &setup).unwrap());
            let (like, apart) =
                first.presets.iter().zip(apart).min_by_key(|(_, apart)| apart.len()).unwrap();
            let keys: Vec<String> = apart
                .iter()
                .map(|other| format!("`{}` is `{}`", other.key, other.theirs))
                .collect();
            let (name, preset, like) = (other.name, preset.name, like.name);
            let unlike =
                if preset == like { String::new() } else { format!(", as `{like}` but for") };
            writeln!(text, "- `{name}`, preset `{preset}`{unlike}: {}.", keys.join(", ")).unwrap();
        }
    }
    text
}

#[test]
fn the_page_lists_every_key() {
    let mut page = HEAD.to_owned();
    let compared = [COMA, COMA_SAC, MADDPG, MADDPG_SAC, DDPG];
    let pages = [
        (ALMA, &[FLAT, COPA][..]),
        (QMIX, &[VDN, REFIL]),
        (MAAC, &compared),
        (HAL, &[HAL_ORACLE, H_DQN]),
        (DQN, &[]),
        (MA_EXP, &[]),
    ];
    for (first, like_it) in pages {
        page += &first.reference().unwrap();
        if !like_it.is_empty() {
            page += &others(&first, like_it);
        }
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/reference/configuration.md");
    if std::env::var_os("SORTIE_WRITE_DOCS").is_some() {
        std::fs::write(path, &page).unwrap();
    }
    assert!(
        std::fs::read_to_string(path).unwrap_or_default() == page,
        "docs/reference/configuration.md is another: SORTIE_WRITE_DOCS=1 cargo test -p sortie-methods --test reference"
    );
}

#[test]
fn the_page_of_environments_lists_every_setting() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/reference/environments.md");
    let page = std::fs::read_to_string(path).unwrap();
    for entry in ENVIRONMENTS {
        let (_, section) = page.split_once(&format!("\n### {}\n", entry.name)).unwrap();
        let section = section.split("\n### ").next().unwrap();
        // What refuses a setting names all that there are.
        let unknown = [("no_such_setting".to_owned(), Setting::Whole(1))].into();
        let Err(refusal) = sortie_envs::open(entry.name, Split::Train, 1, &unknown) else {
            panic!("{} takes any setting", entry.name)
        };
        let refusal = refusal.to_string();
        let (_, known) = refusal.split_once("expected ").unwrap();
        let names: Vec<&str> = known.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "{refusal}");
        for name in names {
            assert!(section.contains(&format!("\n| `{name}` |")), "{}: {name}", entry.name);
        }
    }
}
