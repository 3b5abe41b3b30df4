//! README and docs: links lead somewhere, commands are those of the real grammar, pages are found from their index.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Words that stand for something, and what the grammar may take in their place.
const PLACEHOLDERS: [(&str, &str); 7] = [
    ("METHOD", "alma"),
    ("BOARD", "cortex-m4f"),
    ("SHELL", "bash"),
    ("RULE", "learned"),
    ("N", "1"),
    ("S", "1"),
    ("SEED", "1"),
];
/// What a front page may be at most.
const LINES: usize = 110;
const COLUMNS: usize = 120;

/// Every page, as paths from the root of the project.
fn pages() -> Vec<PathBuf> {
    let mut pages = vec!["README.md".into(), "CONTRIBUTING.md".into(), "SECURITY.md".into()];
    let mut folders = vec![PathBuf::from("docs")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                pages.push(path);
            }
        }
    }
    pages
}

fn read(page: &Path) -> String {
    fs::read_to_string(page).unwrap_or_else(|error| panic!("{}: {error}", page.display()))
}

/// The lines of a page, and whether each stands in a fenced block.
fn lines(text: &str) -> impl Iterator<Item = (&str, bool)> {
    let mut fenced = false;
    text.lines().filter_map(move |line| {
        let is_fence = line.trim_start().starts_with("```");
        fenced ^= is_fence;
        (!is_fence).then_some((line, fenced))
    })
}

/// Where the headings of a page can be linked to, as GitHub names them.
fn anchors(text: &str) -> Vec<String> {
    let mut times = HashMap::new();
    let headings = lines(text).filter(|(line, fenced)| !fenced && line.starts_with('#'));
    let anchor = |(line, _): (&str, bool)| {
        let kept = |c: char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let name: String = title.chars().filter(|c| kept(*c)).collect();
        let name = name.replace(' ', "-");
        let before = times.entry(name.clone()).or_insert(0);
        *before += 1;
        if *before == 1 { name } else { format!("{name}-{}", *before - 1) }
    };
    headings.map(anchor).collect()
}

/// What a page links to within the project.
fn links(text: &str) -> Vec<String> {
    let prose = lines(text).filter(|(_, fenced)| !fenced).map(|(line, _)| line);
    let targets = prose.flat_map(|line| line.split("](").skip(1));
    let targets = targets.filter_map(|rest| rest.split_once(')')).map(|(target, _)| target);
    targets.filter(|target| !target.contains("://")).map(str::to_owned).collect()
}

/// Why a link of a page leads nowhere.
fn broken(page: &Path, link: &str) -> Option<String> {
    let (path, anchor) = link.split_once('#').unwrap_or((link, ""));
    let folder = page.parent().expect("a folder");
    let target = if path.is_empty() { page.to_owned() } else { folder.join(path) };
    let said = format!("{}: {link}", page.display());
    if !target.exists() {
        return Some(format!("{said}: no such file"));
    }
    let leads = anchor.is_empty() || anchors(&read(&target)).iter().any(|name| name == anchor);
    (!leads).then(|| format!("{said}: no such heading"))
}

#[test]
fn every_link_leads_somewhere() {
    let mut count = 0;
    let mut wrong = Vec::new();
    for page in pages() {
        let links = links(&read(&page));
        count += links.len();
        wrong.extend(links.iter().filter_map(|link| broken(&page, link)));
    }
    assert_eq!(wrong, Vec::<String>::new());
    assert!(count > 200, "{count} links were found");
    let page = Path::new("docs/README.md");
    assert!(broken(page, "guide/no-such-page.md").is_some());
    assert!(broken(page, "guide/start.md#no-such-heading").is_some());
}

#[test]
fn every_page_is_in_the_index_of_its_folder() {
    for page in pages().iter().filter(|page| page.starts_with("docs/")) {
        let name = page.file_name().expect("a name").to_str().expect("text");
        let (folder, name) = match (page.parent().expect("a folder"), name) {
            (folder, "README.md") => {
                (folder.parent().expect("a folder"), page.strip_prefix("docs"))
            }
            (folder, name) => (folder, Ok(Path::new(name))),
        };
        let name = name.expect("a page of docs").display().to_string();
        if !folder.as_os_str().is_empty() && !folder.starts_with("docs/evidence/results") {
            let index = read(&folder.join("README.md"));
            assert!(index.contains(&format!("]({name})")), "{name} is not in {}", folder.display());
        }
    }
}

#[test]
fn the_front_page_is_short() {
    let text = read(Path::new("README.md"));
    assert!(text.lines().count() <= LINES, "{} lines", text.lines().count());
    for line in text.lines() {
        assert!(line.chars().count() <= COLUMNS, "{} columns: {line}", line.chars().count());
    }
}

/// A command line as a shell splits it, up to what ends it there.
fn words(command: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quote = None;
    let mut last = ' ';
    for c in command.chars() {
        match (quote, c) {
            (Some(open), c) if open == c => quote = None,
            (None, '\'' | '"') => quote = Some(c),
            (None, ' ') if last != ' ' => words.push(String::new()),
            (None, ' ') => {}
            (None, '#') if last == ' ' => break,
            (None, ';' | '|' | '>' | '&') => break,
            _ => words.last_mut().expect("a word").push(c),
        }
        last = c;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// The arguments of every command of `sortie` in a text.
fn arguments(text: &str) -> Vec<Vec<String>> {
    let fenced = text.replace("\\\n", " ");
    let fenced = lines(&fenced).filter(|(_, fenced)| *fenced).map(|(line, _)| line.to_owned());
    let code = |line: &str| line.split('`').skip(1).step_by(2).map(str::to_owned).collect();
    let cells = lines(text).filter(|(line, fenced)| !fenced && line.starts_with('|'));
    let cells = cells.flat_map(|(line, _)| -> Vec<String> { code(line) });
    let pieces = |line: String| -> Vec<String> {
        line.split("&&").flat_map(|part| part.split("; ")).map(str::to_owned).collect()
    };
    fenced.chain(cells).flat_map(pieces).filter_map(|command| own(&words(&command))).collect()
}

/// What follows `sortie`, by whichever name it is started; none for other programs and for what is left to the reader.
fn own(words: &[String]) -> Option<Vec<String>> {
    let is_setting = |word: &&String| word.contains('=') && word.starts_with(char::is_uppercase);
    let words: Vec<&str> = words.iter().skip_while(is_setting).map(String::as_str).collect();
    let arguments = match words[..] {
        ["sortie", ref arguments @ ..]
        | ["cargo", "run", "--release", "--", ref arguments @ ..] => arguments,
        _ => return None,
    };
    let is_open = arguments.iter().any(|word| word.contains(['…', '[', '{']));
    let told = |word: &&str| {
        let placeholder = PLACEHOLDERS.iter().find(|(name, _)| name == word);
        placeholder.map_or(*word, |(_, instead)| instead).to_owned()
    };
    (!is_open && !arguments.is_empty()).then(|| arguments.iter().map(told).collect())
}

/// Starts the program; a refusal is what it says.
fn refusal(arguments: &[String]) -> Option<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_sortie")).args(arguments).output();
    let output = output.expect("it starts");
    let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
    (!output.status.success()).then(|| format!("sortie {}: {said}", arguments.join(" ")))
}

/// The same command, which only tells: `--help` comes last, so that what is wrong before it is noticed and nothing is
/// done; what a training would learn by is printed besides, for keys and values of its configuration.
fn harmless(arguments: &[String]) -> Vec<Vec<String>> {
    let with = |arguments: &[String], flag: &str| [arguments, &[flag.to_owned()]].concat();
    let mut harmless = vec![with(arguments, "--help")];
    let places = ["--out", "--seeds"];
    let is_resumed = arguments.iter().any(|word| word == "--resume");
    if arguments[0] == "train" && arguments.len() > 1 && !is_resumed {
        let mut told = arguments.to_vec();
        while let Some(at) = told.iter().position(|word| places.contains(&word.as_str())) {
            told.drain(at..(at + 2).min(told.len()));
        }
        told.retain(|word| word != "--print-config");
        harmless.push(with(&told, "--print-config"));
    }
    harmless
}

#[test]
fn every_command_is_one_of_the_grammar() {
    let mut commands: Vec<Vec<String>> =
        pages().iter().flat_map(|page| arguments(&read(page))).collect();
    commands.sort();
    commands.dedup();
    assert!(commands.len() > 100, "{} commands were found", commands.len());
    let wrong = commands.iter().flat_map(|command| harmless(command));
    let wrong: Vec<String> = wrong.filter_map(|command| refusal(&command)).collect();
    assert_eq!(wrong, Vec::<String>::new());
}

#[test]
fn a_wrong_verb_flag_value_or_key_is_noticed() {
    let wrong =
        ["tarin alma", "train alma --sed 3", "train alma --steps many", "train alma --set no=1"];
    for command in wrong {
        let refusals = harmless(&words(command));
        assert!(refusals.iter().any(|command| refusal(command).is_some()), "{command}");
    }
    let right = harmless(&words("train alma --seeds 1..5 --out runs/five"));
    assert_eq!(right.iter().filter_map(|command| refusal(command)).next(), None);
}

#[test]
fn commands_are_found_in_blocks_and_in_tables() {
    let text = "```sh\nX=1 sortie run 'a b' --flag  # why\nsortie eval a && sortie man b | head\n```\n\
        | `sortie doctor` |\nIn prose `sortie no-verb` is left to the reader.\n";
    let found = arguments(text);
    let expected =
        [vec!["run", "a b", "--flag"], vec!["eval", "a"], vec!["man", "b"], vec!["doctor"]];
    assert_eq!(found, expected);
}
