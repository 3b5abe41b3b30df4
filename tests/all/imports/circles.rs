//! Circles among the modules of a crate.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use super::modules::{Import, ModulePath};

/// Two siblings of one folder, in the direction of the import.
pub(crate) type Edge = (String, String);

/// Siblings of one folder that import each other, each with everything below it.
#[derive(Debug)]
pub(crate) struct Circle {
    /// Where they stand.
    folder: ModulePath,
    names: BTreeSet<String>,
    /// The lines of every import among them.
    lines: BTreeMap<Edge, Vec<String>>,
}

/// Finds the circles of a crate.
///
/// An import counts between the two siblings under which its ends part: of `a::b::c` that names `a::d::e`, between
/// `b` and `d` in the folder `a`, so a folder is one module beside its siblings, whatever stands in it.
/// What a module and the modules inside it name of each other does not count: they are one thing, seen from outside.
/// An import leads to the definition, through all re-exports, and code for tests may import what it likes.
pub(crate) fn circles(imports: impl IntoIterator<Item = Import>) -> Vec<Circle> {
    let mut folders: BTreeMap<ModulePath, BTreeMap<Edge, Vec<String>>> = BTreeMap::new();
    for Import { from, to, line } in imports {
        let shared = from.iter().zip(&to).take_while(|(from, to)| from == to).count();
        let (Some(importer), Some(imported)) = (from.get(shared), to.get(shared)) else { continue };
        let edge = (importer.clone(), imported.clone());
        folders.entry(from[..shared].to_vec()).or_default().entry(edge).or_default().push(line);
    }
    folders.into_iter().flat_map(|(folder, edges)| circles_of_folder(&folder, edges)).collect()
}

fn circles_of_folder(folder: &ModulePath, edges: BTreeMap<Edge, Vec<String>>) -> Vec<Circle> {
    let mut circles = Vec::<Circle>::new();
    let reached: BTreeMap<&String, BTreeSet<&String>> =
        edges.keys().map(|(from, _)| (from, reached_from(from, &edges))).collect();
    let reaches =
        |from: &String, to: &String| reached.get(from).is_some_and(|reached| reached.contains(to));
    for (name, _) in edges.keys() {
        if !reaches(name, name) || circles.iter().any(|circle| circle.names.contains(name)) {
            continue;
        }
        let names: BTreeSet<String> = (reached[name].iter())
            .filter(|other| reaches(other, name))
            .map(|&other| other.clone())
            .collect();
        let among = |(from, to): &Edge| names.contains(from) && names.contains(to);
        let lines = edges.iter().filter(|(edge, _)| among(edge));
        let lines = lines.map(|(edge, lines)| (edge.clone(), lines.clone())).collect();
        circles.push(Circle { folder: folder.clone(), names, lines });
    }
    circles
}

fn reached_from<'a>(
    start: &'a String,
    edges: &'a BTreeMap<Edge, Vec<String>>,
) -> BTreeSet<&'a String> {
    let mut reached = BTreeSet::new();
    let mut waiting = vec![start];
    while let Some(at) = waiting.pop() {
        for (_, to) in edges.keys().filter(|(from, _)| from == at) {
            if reached.insert(to) {
                waiting.push(to);
            }
        }
    }
    reached
}

impl fmt::Display for Circle {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let folder: String = self.folder.iter().map(|name| format!("::{name}")).collect();
        let names: Vec<&str> = self.names.iter().map(String::as_str).collect();
        writeln!(formatter, "circle of {} in `crate{folder}`: {}", names.len(), names.join(", "))?;
        for ((from, to), lines) in &self.lines {
            writeln!(formatter, "  {from} imports {to}")?;
            for line in lines {
                writeln!(formatter, "    {line}")?;
            }
        }
        Ok(())
    }
}
