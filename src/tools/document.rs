//! Markdown documents with a table that figures are held to, and written to.

use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use sortie_cli::failure::Failure;

/// A row of a table.
pub(crate) type Row = Vec<String>;

/// What a table is of.
#[derive(Clone, Copy)]
pub(crate) struct Columns {
    pub(crate) names: &'static [&'static str],
    /// Columns from the left that say what a row is of.
    pub(crate) keys: usize,
}

/// A document with one such table.
pub(crate) struct Document {
    columns: Columns,
    before: String,
    rows: Vec<Row>,
    after: String,
}

impl Document {
    /// Reads the document of a file; one that is to be written may be missing.
    pub(crate) fn open(path: &Path, columns: Columns, write: bool) -> Result<Self, Failure> {
        let document = match fs::read_to_string(path) {
            Err(error) if write && error.kind() == ErrorKind::NotFound => String::new(),
            document => document.map_err(|error| Failure::file(path, &error))?,
        };
        Ok(Self::read(&document, columns))
    }

    /// Finds the table of a document; where there is none, one is to be written behind its last line.
    pub(crate) fn read(document: &str, columns: Columns) -> Self {
        let header = line(columns.names);
        let Some((before, rest)) = document.split_once(&header) else {
            let before = document.to_owned();
            return Self { columns, before, rows: Vec::new(), after: String::new() };
        };
        let cells = |line: &str| {
            line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()
        };
        let is_row = |line: &&str| line.starts_with('|');
        let table = rest.split_inclusive('\n').take_while(is_row).map(str::len).sum();
        let (table, after) = rest.split_at(table);
        let rows: Vec<Row> = table.lines().skip(1).map(cells).collect();
        let rows = rows.into_iter().filter(|row| row.len() == columns.names.len()).collect();
        Self { columns, before: before.to_owned(), rows, after: after.to_owned() }
    }

    /// Puts a row in the place of the one that is of the same.
    pub(crate) fn put(&mut self, row: Row) {
        self.rows.retain(|other| !is_same(other, &row, self.columns.keys));
        self.rows.push(row);
        self.rows.sort();
    }

    /// The recorded row that is of the same.
    pub(crate) fn same(&self, row: &Row) -> Option<&Row> {
        self.rows.iter().find(|other| is_same(other, row, self.columns.keys))
    }

    pub(crate) fn write(&self) -> String {
        let names = self.columns.names;
        let rule = line(&vec!["---"; names.len()]);
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        [&self.before, &line(names), &rule, &rows, &self.after].map(String::as_str).concat()
    }
}

fn is_same(one: &Row, other: &Row, keys: usize) -> bool {
    one.iter().zip(other).take(keys).all(|(one, other)| one == other)
}

/// A line of a Markdown table.
pub(crate) fn line(cells: &[impl AsRef<str>]) -> String {
    let cells: String = cells.iter().map(|cell| format!(" {} |", cell.as_ref())).collect();
    format!("|{cells}\n")
}
