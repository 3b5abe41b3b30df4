//! The pages about the keys of methods and the settings of environments say what the program knows.

use std::fmt::Write as _;

use sortie_envs::registry::Setting;
use sortie_envs::{ENVIRONMENTS, Split};
use sortie_learn::configuration::{Key, Range, Section};
use sortie_learn::run::Difference;
use sortie_learn::session::MethodEntry;
use sortie_methods::METHODS;
use sortie_methods::allocator::ALLOCATOR;
use sortie_methods::alma::{ALMA, COPA, FLAT};
use sortie_methods::dqn::DQN;
use sortie_methods::hal::{H_DQN, HAL, HAL_ORACLE};
use sortie_methods::ma_exp::MA_EXP;
use sortie_methods::maac::{COMA, COMA_SAC, DDPG, MAAC, MADDPG, MADDPG_SAC};
use sortie_methods::mappo::{IPPO, MAPPO};
use sortie_methods::value_factorisation::{QMIX, REFIL, VDN};
use toml::Table;

const HEAD: &str = "\
# The configuration, key by key

`sortie train METHOD --print-config` prints the configuration that a command would learn by, with all of this as comments; it
takes `--env`, `--preset`, `--config`, `--set` and the other flags. What it prints is a file for `--config`, which may leave out what it
does not change. `--set replay.batch=256` changes one value. A value outside its range, or a key that does not exist, is
refused with exit code 2, by key, value and range, in files also by line. `train.toml` in a run's folder holds the values
that the run learns by; `sortie train METHOD --resume DIR --steps N` changes `run.steps` and nothing else.

`--mixer M`, `--no-mask` and `--allocation RULE` are short for `--set` of the keys that they are about.

In the preset `fast` of `alma` and `flat`, runs of less than 600,000 steps shrink `exploration.steps`, `allocator.learns_from` and
`allocator.decides_from` in proportion, unless they are set.

Every key stands here once, under its section of the file, with the methods that have it (where a section is of several) and its value in
their presets `fast` and `paper`. Ranges hold both ends: `1..64` of whole numbers, `0.0..1.0` of others, with the unit behind them.
Methods that differ from one of these in a few keys are [at the end](#methods-like-others).

This page is written by the program; a test compares them.
";

/// The settings of environments are explained elsewhere.
const SETTINGS: &str = "environment.settings";

/// The methods of the page; each stands for those that are like it.
fn pages() -> [(MethodEntry, Vec<MethodEntry>); 8] {
    [
        (ALMA, vec![FLAT, COPA]),
        (ALLOCATOR, vec![]),
        (QMIX, vec![VDN, REFIL]),
        (MAPPO, vec![IPPO]),
        (MAAC, vec![COMA, COMA_SAC, MADDPG, MADDPG_SAC, DDPG]),
        (HAL, vec![HAL_ORACLE, H_DQN]),
        (DQN, vec![]),
        (MA_EXP, vec![]),
    ]
}

/// A section of the file in one preset of a method, and the values of all its keys.
struct Part {
    method: &'static str,
    preset: &'static str,
    section: Section,
    values: Table,
}

fn parts() -> Vec<Part> {
    let mut parts = Vec::new();
    for (method, _) in pages() {
        for preset in method.presets {
            let setup = method.preset(preset.name).unwrap();
            let table = setup.table().unwrap();
            for section in method.sections(&setup.own) {
                let names = section.name.split('.').filter(|name| !name.is_empty());
                let values = names.fold(&table, |table, name| table[name].as_table().unwrap());
                let (method, preset, values) = (method.name, preset.name, values.clone());
                parts.push(Part { method, preset, section, values });
            }
        }
    }
    parts
}

/// Items in the order in which they come first, each once.
fn each_once<T: PartialEq>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut once = Vec::new();
    for item in items {
        if !once.contains(&item) {
            once.push(item);
        }
    }
    once
}

fn range(key: &Key) -> String {
    let range = match key.range {
        Range::Whole(from, to) => format!("{from}..{to}"),
        Range::Number(from, to) => format!("{from:?}..{to:?}"),
        Range::Positive(to) => format!("above 0.0..{to:?}"),
        Range::Numbers(from, to) => format!("list of {from:?}..{to:?}"),
        Range::OneOf(words) => format!("`{}`", words.join("`/`")),
        Range::Truth => "`true`/`false`".to_owned(),
        other => other.to_string(),
    };
    if key.unit.is_empty() { range } else { format!("{range} {}", key.unit) }
}

/// A cell by methods: what they all have alike is said without their names.
fn by_method(cells: &[(&'static str, String)]) -> String {
    let values = each_once(cells.iter().map(|(_, value)| value));
    let named = |value: &&String| {
        let methods = cells.iter().filter(|(_, other)| other == *value).map(|(method, _)| *method);
        format!("{value} {}", each_once(methods).join(", "))
    };
    match values[..] {
        [] => String::new(),
        [value] => value.clone(),
        _ => values.iter().map(named).collect::<Vec<_>>().join("; "),
    }
}

/// The table of one section: every key of it once. What is alike in all rows is no column.
fn table(parts: &[&Part]) -> String {
    let rows =
        each_once(parts.iter().flat_map(|part| {
            part.section.keys.iter().map(|key| (key.name, range(key), key.about))
        }));
    let presets = each_once(parts.iter().map(|part| part.preset));
    let is_of_several = each_once(parts.iter().map(|part| part.method)).len() > 1;
    let of = is_of_several.then_some("of".to_owned());
    let presets_said = presets.iter().map(|preset| format!("`{preset}`"));
    let columns = ["key".to_owned()].into_iter().chain(of).chain(presets_said);
    let columns: Vec<_> = columns.chain(["range".to_owned(), "what".to_owned()]).collect();
    let mut text = format!("\n{}{}", row(&columns), row(&vec!["---".to_owned(); columns.len()]));
    for (name, limits, about) in rows {
        let is_this =
            |key: &Key| (key.name, range(key), key.about) == (name, limits.clone(), about);
        let having: Vec<_> =
            parts.iter().filter(|part| part.section.keys.iter().any(is_this)).collect();
        let methods = each_once(having.iter().map(|part| part.method)).join(", ");
        let in_preset = |preset: &&str| {
            let of_it = having.iter().filter(|part| part.preset == *preset);
            let values = of_it.map(|part| (part.method, format!("`{}`", part.values[name])));
            by_method(&values.collect::<Vec<_>>())
        };
        let cells = [format!("`{name}`")].into_iter().chain(is_of_several.then_some(methods));
        let cells = cells.chain(presets.iter().map(in_preset));
        text += &row(&cells.chain([limits.clone(), about.to_owned()]).collect::<Vec<_>>());
    }
    text
}

fn row(cells: &[String]) -> String {
    format!("| {} |\n", cells.join(" | "))
}

/// All sections, each once, in the order of files.
fn sections() -> String {
    let parts = parts();
    let mut text = String::new();
    let mut names = each_once(parts.iter().map(|part| part.section.name));
    names.sort_by_key(|name| !name.is_empty());
    for name in names.into_iter().filter(|name| *name != SETTINGS) {
        let heading = if name.is_empty() { "At the top" } else { name };
        let of_it: Vec<_> = parts.iter().filter(|part| part.section.name == name).collect();
        write!(text, "\n## {heading}\n\n").unwrap();
        for about in each_once(of_it.iter().map(|part| part.section.about)) {
            let saying = of_it.iter().filter(|part| part.section.about == about);
            let of = each_once(saying.map(|part| part.method)).join(", ");
            writeln!(text, "- {of}: {about}").unwrap();
        }
        text += &table(&of_it);
    }
    text
}

/// What methods have otherwise than a first one.
fn others(first: &MethodEntry, others: &[MethodEntry]) -> String {
    let mut text = String::new();
    for other in others {
        for preset in other.presets {
            let setup = other.preset(preset.name).unwrap();
            // The preset of the first that is most like it.
            let presets = first.presets.iter().map(|preset| first.preset(preset.name).unwrap());
            let apart = presets.map(|usual| Difference::between(&usual, &setup).unwrap());
            let (like, apart) =
                first.presets.iter().zip(apart).min_by_key(|(_, apart)| apart.len()).unwrap();
            let keys: Vec<String> =
                apart.iter().map(|other| format!("`{}` = `{}`", other.key, other.theirs)).collect();
            let (name, first, preset, like) = (other.name, first.name, preset.name, like.name);
            let keys = keys.join(", ");
            writeln!(text, "| `{name}` | `{preset}` | `{first}`, `{like}` | {keys} |").unwrap();
        }
    }
    text
}

#[test]
fn the_page_says_every_key_once() {
    let mut page = HEAD.to_owned();
    page += "\n## environment.settings\n\nNumbers of the rules that differ from the usual ones: \
        `--set environment.settings.episode_limit=100`. Which there are is up to the environment, see \
        [environments.md](environments.md#settings).\n";
    page += &sections();
    page += "\n## Methods like others\n\n| method | preset | as | but for |\n| --- | --- | --- | --- |\n";
    let mut told = Vec::new();
    for (first, like_it) in pages() {
        page += &others(&first, &like_it);
        told.extend(like_it.iter().chain([&first]).map(|method| method.name));
    }
    for method in METHODS {
        assert!(told.contains(&method.name), "`{}` is not on the page", method.name);
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/reference/configuration.md");
    if std::env::var_os("SORTIE_WRITE_DOCS").is_some() {
        std::fs::write(path, &page).unwrap();
    }
    assert!(
        std::fs::read_to_string(path).unwrap_or_default() == page,
        "docs/reference/configuration.md is another: SORTIE_WRITE_DOCS=1 cargo test -p sortie-methods --test all reference::"
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
