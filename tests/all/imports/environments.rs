//! Where the sources name environments: in their own folders, and in a line of a registry. And where they name methods.

use std::fs;
use std::path::{Path, PathBuf};

use sortie_envs::ENVIRONMENTS;
use sortie_methods::METHODS;

use super::tokens::tokens;

/// Files that name each environment so many times at most: as a module and in a registry.
const REGISTRIES: [(&str, usize); 4] = [
    ("trainer/envs/src/lib.rs", 1),
    ("trainer/envs/src/registry.rs", 1),
    // One environment has recordings that are played again, and reports of two count what was reached.
    ("src/cli/views/mod.rs", 3),
    ("src/cli/views/figures.rs", 3),
];

/// Folders of sources that know environments by their seam alone.
const FOLDERS: [&str; 5] =
    ["src", "trainer/envs/src", "trainer/nn/src", "trainer/learn/src", "trainer/methods/src"];

#[test]
fn environments_are_named_in_their_folders_and_registries_alone() {
    let mut wrong = String::new();
    for file in FOLDERS.iter().flat_map(|folder| sources(Path::new(folder))) {
        let text = without_tests(fs::read_to_string(&file).expect("a source file"));
        for entry in ENVIRONMENTS {
            let module = entry.name.replace('-', "_");
            if file.iter().any(|folder| folder == module.as_str()) {
                continue;
            }
            let named = named(&text, entry.name, &module);
            let registry = REGISTRIES.iter().find(|(registry, _)| file == Path::new(registry));
            if named.len() > registry.map_or(0, |(_, most)| *most) {
                let lines = format!("{}: lines {named:?} name {}\n", file.display(), entry.name);
                wrong.push_str(&lines);
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn the_engine_names_no_method() {
    let mut wrong = String::new();
    for file in ["trainer/nn/src", "trainer/learn/src"].map(Path::new).into_iter().flat_map(sources)
    {
        let text = without_tests(fs::read_to_string(&file).expect("a source file"));
        for name in METHODS.iter().map(|entry| entry.name) {
            // The mixer has the name of the method that brought it, and an allocator is a word for more than a method.
            if name == "qmix" && file.ends_with("networks/mixer.rs") || name == "allocator" {
                continue;
            }
            let words = tokens(&text).into_iter();
            let found = words.filter(|token| token.text.to_lowercase() == name);
            let lines: Vec<usize> = found.map(|token| token.line).collect();
            if !lines.is_empty() || text.contains(&format!("\"{name}\"")) {
                wrong.push_str(&format!("{}: lines {lines:?} name {name}\n", file.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn a_name_is_found_in_code_and_not_in_comments() {
    let text = "//! save_the_city\nuse a::save_the_city::B;\nlet x = SaveTheCity;\nf(\"save-the-city\");\n\
        f(\"models/save-the-city\");\n";
    assert_eq!(named(text, "save-the-city", "save_the_city"), [2, 3, 4]);
}

/// The lines that name an environment: by its module, by the same in one word, or as a text.
fn named(text: &str, name: &str, module: &str) -> Vec<usize> {
    let one_word = module.replace('_', "");
    let is_named =
        |word: &str| word == module || word.to_lowercase() == one_word && word != one_word;
    let words = tokens(text).into_iter().filter(|token| is_named(&token.text));
    let literal = format!("\"{name}\"");
    let literals = text.lines().enumerate().filter(|(_, line)| line.contains(&literal));
    words.map(|token| token.line).chain(literals.map(|(line, _)| line + 1)).collect()
}

/// The code of a file before that of its tests, which may name what they like.
fn without_tests(text: String) -> String {
    text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default().to_owned()
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let for_tests = modules_for_tests(folder);
    let is_for_tests =
        |path: &Path| for_tests.iter().any(|name| path.file_stem() == Some(name.as_ref()));
    let entries = fs::read_dir(folder).expect("a folder of sources").flatten();
    let found = entries.flat_map(|entry| match entry.path() {
        path if is_for_tests(&path) || path.ends_with("tests") => Vec::new(),
        path if path.is_dir() => sources(&path),
        path if path.extension().is_some_and(|end| end == "rs") => vec![path],
        _ => Vec::new(),
    });
    found.collect()
}

/// The modules of a folder that stand in files of their own and are there for tests alone.
fn modules_for_tests(folder: &Path) -> Vec<String> {
    let text = fs::read_to_string(folder.join("mod.rs")).unwrap_or_default();
    let declared = text.split("#[cfg(test)]\nmod ").skip(1);
    declared.filter_map(|rest| Some(rest.split_once(';')?.0.to_owned())).collect()
}
