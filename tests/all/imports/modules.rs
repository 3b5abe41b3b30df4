//! The modules of a crate: which there are, and what each of them names.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::tokens::{Token, tokens};

/// Where a module stands: names from the root of its crate, whose own path is empty.
pub(crate) type ModulePath = Vec<String>;

/// How far an import is followed from one re-export to the next.
const FOLLOWED: usize = 16;

/// A module and what its text says.
#[derive(Debug, Default)]
pub(crate) struct Module {
    file: PathBuf,
    /// Functions, types, traits, constants and macros that it defines.
    items: Vec<String>,
    /// What `use` lines call by which name here.
    names: BTreeMap<String, Vec<String>>,
    /// `use path::*`.
    globs: Vec<Vec<String>>,
    /// Every path in it, as it is written, with its line.
    mentions: Vec<(Vec<String>, usize)>,
}

/// One module names something of another.
#[derive(Debug)]
pub(crate) struct Import {
    pub(crate) from: ModulePath,
    pub(crate) to: ModulePath,
    /// `file:line: path`.
    pub(crate) line: String,
}

/// All modules of a crate but those for tests.
#[derive(Debug, Default)]
pub(crate) struct Crate {
    modules: BTreeMap<ModulePath, Module>,
}

impl Crate {
    /// Reads a crate from its root file, `lib.rs` or `main.rs`.
    pub(crate) fn read(root: &Path) -> Self {
        let mut read = Self::default();
        read.file(Vec::new(), root);
        read
    }

    fn file(&mut self, path: ModulePath, file: &Path) {
        let source = fs::read_to_string(file)
            .unwrap_or_else(|error| panic!("{} of `{}`: {error}", file.display(), path.join("::")));
        let stem = file.file_stem().unwrap_or_default();
        let is_root = ["lib", "main", "mod"].iter().any(|&name| stem == name);
        let folder = file.with_file_name(if is_root { "".as_ref() } else { stem });
        self.module(path, file, &folder, &tokens(&source));
    }

    /// Reads a module's text. `folder` is where its children have their files.
    fn module(&mut self, path: ModulePath, file: &Path, folder: &Path, text: &[Token]) {
        let mut module = Module { file: file.into(), ..Module::default() };
        let mut at = 0;
        // `#[path = "."]`: the files of a module inside this file lie beside it. No other path is written.
        let mut is_beside = false;
        while at < text.len() {
            let words = Words(&text[at..]);
            at += match words.get(0) {
                "#" => {
                    is_beside |= words.get(2) == "path";
                    let attribute = words.attribute();
                    let is_test = Words(&words.0[..attribute]).are_for_tests();
                    attribute + if is_test { words.from(attribute).item() } else { 0 }
                }
                "mod" if words.get(2) == ";" => {
                    let name = words.get(1);
                    let beside = folder.join(name).with_extension("rs");
                    let inside = folder.join(name).join("mod.rs");
                    let child = if beside.exists() { beside } else { inside };
                    self.file(below(&path, name), &child);
                    3
                }
                "mod" if words.get(2) == "{" => {
                    let name = words.get(1);
                    let length = words.item();
                    let inner = &words.0[3..length - 1];
                    let inside =
                        folder.join(if std::mem::take(&mut is_beside) { "" } else { name });
                    self.module(below(&path, name), file, &inside, inner);
                    length
                }
                // `use<'a>` of a type is no import.
                "use" if words.get(1) != "<" => module.imports(words),
                "crate" | "super" | "self" if words.get(1) == "::" => module.mention(words),
                "fn" | "struct" | "enum" | "union" | "trait" | "const" | "static" | "type" => {
                    module.items.push(words.get(1).into());
                    1
                }
                "macro_rules" if words.get(1) == "!" => {
                    module.items.push(words.get(2).into());
                    3
                }
                _ => 1,
            };
        }
        self.modules.insert(path, module);
    }

    /// Every import of one module from another, at its definition: re-exports are followed.
    pub(crate) fn imports(&self) -> impl Iterator<Item = Import> {
        self.modules.iter().flat_map(move |(from, module)| {
            module.mentions.iter().filter_map(move |(mention, line)| {
                let to = self.definition(from, mention, FOLLOWED)?;
                let line = format!("{}:{line}: {}", module.file.display(), mention.join("::"));
                Some(Import { from: from.clone(), to, line })
            })
        })
    }

    /// The module that defines what a path means in the module `from`; nothing where another crate does.
    fn definition(&self, from: &[String], path: &[String], left: usize) -> Option<ModulePath> {
        let (start, rest) = self.start(from, path)?;
        self.walk(start, rest, left)
    }

    fn start<'a>(&self, from: &[String], path: &'a [String]) -> Option<(ModulePath, &'a [String])> {
        let (first, rest) = path.split_first()?;
        match first.as_str() {
            "crate" => Some((Vec::new(), rest)),
            "self" => Some((from.to_vec(), rest)),
            "super" => {
                let parent = &from[..from.len().checked_sub(1)?];
                match rest.first().map(String::as_str) {
                    Some("super") => self.start(parent, rest),
                    _ => Some((parent.to_vec(), rest)),
                }
            }
            name => {
                let module = &self.modules[from];
                let named = module.names.get(name).is_some_and(|named| named[0] != name);
                let known = named || self.modules.contains_key(&below(from, name));
                known.then(|| (from.to_vec(), path))
            }
        }
    }

    fn walk(&self, at: ModulePath, rest: &[String], left: usize) -> Option<ModulePath> {
        let Some((name, rest)) = rest.split_first() else { return Some(at) };
        let left = left.checked_sub(1)?;
        let child = below(&at, name);
        if self.modules.contains_key(&child) {
            return self.walk(child, rest, left);
        }
        let module = &self.modules[&at];
        if module.items.contains(name) {
            return Some(at);
        }
        if let Some(path) = module.names.get(name) {
            let whole: Vec<String> = path.iter().chain(rest).cloned().collect();
            return self.definition(&at, &whole, left);
        }
        let below_glob = |glob: &Vec<String>| {
            let place = self.definition(&at, glob, left)?;
            let found = self.walk(place.clone(), std::slice::from_ref(name), left)?;
            (found != place || self.defines(&place, name)).then_some(found)
        };
        module.globs.iter().find_map(below_glob).or(Some(at))
    }

    fn defines(&self, place: &ModulePath, name: &String) -> bool {
        self.modules[place].items.contains(name)
    }
}

impl Module {
    /// Reads a `use` line.
    fn imports(&mut self, words: Words<'_>) -> usize {
        1 + self.tree(words.from(1), &[]) + 1
    }

    /// Reads a tree of a `use` line below the path before it, up to the sign that ends it.
    fn tree(&mut self, words: Words<'_>, before: &[String]) -> usize {
        let mut path = before.to_vec();
        let mut at = 0;
        let line = words.0[0].line;
        loop {
            match words.get(at) {
                "::" => at += 1,
                "{" => {
                    at += 1;
                    while words.get(at) != "}" {
                        at += self.tree(words.from(at), &path);
                        at += usize::from(words.get(at) == ",");
                    }
                    return at + 1;
                }
                "*" => {
                    self.mentions.push((path.clone(), line));
                    self.globs.push(path);
                    return at + 1;
                }
                "as" => {
                    self.name(words.get(at + 1), path, line);
                    return at + 2;
                }
                "," | "}" | ";" => {
                    let name = path.last().cloned().unwrap_or_default();
                    self.name(&name, path, line);
                    return at;
                }
                // `a::{self, b}` names `a`.
                "self" if at == 0 && !before.is_empty() => at += 1,
                word => {
                    path.push(word.into());
                    at += 1;
                }
            }
        }
    }

    fn name(&mut self, name: &str, path: Vec<String>, line: usize) {
        self.names.insert(name.into(), path.clone());
        self.mentions.push((path, line));
    }

    /// Reads a path that begins with `crate`, `super` or `self`.
    fn mention(&mut self, words: Words<'_>) -> usize {
        let mut path = vec![words.get(0).to_owned()];
        let mut at = 1;
        while words.get(at) == "::" && words.get(at + 1).starts_with(char::is_alphabetic) {
            path.push(words.get(at + 1).into());
            at += 2;
        }
        self.mentions.push((path, words.0[0].line));
        at
    }
}

/// What is left of a text.
#[derive(Clone, Copy)]
struct Words<'a>(&'a [Token]);

impl<'a> Words<'a> {
    fn get(self, at: usize) -> &'a str {
        self.0.get(at).map_or("", |token| &token.text)
    }

    fn from(self, at: usize) -> Self {
        Self(&self.0[at.min(self.0.len())..])
    }

    /// The length of the attribute that begins here.
    fn attribute(self) -> usize {
        let start = if self.get(1) == "!" { 2 } else { 1 };
        start + self.from(start).brackets()
    }

    /// Whether an attribute keeps its item for tests.
    fn are_for_tests(self) -> bool {
        let has = |word: &str| self.0.iter().any(|token| token.text == word);
        self.get(2) == "cfg" && has("test") && !has("not") && !has("any")
    }

    /// The length of the item that begins here, its attributes included.
    fn item(self) -> usize {
        let mut at = 0;
        while at < self.0.len() {
            match self.get(at) {
                "#" => at += self.from(at).attribute(),
                "{" => return at + self.from(at).brackets(),
                "(" | "[" => at += self.from(at).brackets(),
                ";" => return at + 1,
                _ => at += 1,
            }
        }
        at
    }

    /// The length of what the bracket here encloses, both brackets included.
    fn brackets(self) -> usize {
        let mut depth = 0;
        for (at, token) in self.0.iter().enumerate() {
            match token.text.as_str() {
                "(" | "[" | "{" => depth += 1,
                ")" | "]" | "}" => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                return at + 1;
            }
        }
        self.0.len()
    }
}

fn below(path: &[String], name: &str) -> ModulePath {
    path.iter().cloned().chain([name.to_owned()]).collect()
}
