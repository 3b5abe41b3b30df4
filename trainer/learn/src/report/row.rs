//! Any record as a row of named cells, and records as comma-separated values (RFC 4180).
//!
//! Records are read through their JSON form, so that a field which is added to one appears in every
//! table, event file and comparison by itself.

use std::fmt;

use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer, ser};
use serde_json::Value;

/// A record, its nested parts flattened into cells, in the order of its fields.
///
/// Parts are joined by `_`. A list of two is an interval, `_low` and `_high`; the elements of other
/// lists are numbered from 0. Every cell is a number, a text, a truth value or null.
#[derive(Clone, Debug, PartialEq)]
pub struct Row(Vec<(String, Value)>);

impl Row {
    /// Flattens a record; numbers that are not finite become null.
    pub fn of(record: &impl Serialize) -> serde_json::Result<Self> {
        Self::from_json(&serde_json::to_string(record)?)
    }

    /// Flattens a JSON object.
    pub fn from_json(text: &str) -> serde_json::Result<Self> {
        match serde_json::from_str(text)? {
            node @ Node::Fields(_) => {
                let mut cells = Vec::new();
                flatten("", node, &mut cells);
                Ok(Self(cells))
            }
            _ => Err(ser::Error::custom("not an object of named fields")),
        }
    }

    /// The cells by name.
    pub fn cells(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.0.iter().map(|(name, value)| (name.as_str(), value))
    }

    /// The cell of a name.
    pub fn cell(&self, name: &str) -> Option<&Value> {
        self.cells().find(|(other, _)| *other == name).map(|(_, value)| value)
    }

    /// The cell of a name, where it is a number.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.cell(name).and_then(Value::as_f64)
    }

    /// All cells that are numbers.
    pub fn numbers(&self) -> impl Iterator<Item = (&str, f64)> {
        self.cells().filter_map(|(name, value)| Some((name, value.as_f64()?)))
    }
}

impl Serialize for Row {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.cells())
    }
}

/// A JSON value that keeps the order of its fields, as [`Value`] does not.
#[derive(Deserialize)]
#[serde(untagged)]
enum Node {
    Fields(#[serde(deserialize_with = "in_order")] Vec<(String, Node)>),
    List(Vec<Node>),
    Scalar(Value),
}

fn in_order<'de, D: Deserializer<'de>>(of: D) -> Result<Vec<(String, Node)>, D::Error> {
    struct InOrder;

    impl<'de> Visitor<'de> for InOrder {
        type Value = Vec<(String, Node)>;

        fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            formatter.write_str("named fields")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Self::Value, A::Error> {
            std::iter::from_fn(|| entries.next_entry().transpose()).collect()
        }
    }
    of.deserialize_map(InOrder)
}

fn flatten(name: &str, node: Node, cells: &mut Vec<(String, Value)>) {
    let part = |part: &str| {
        if name.is_empty() { part.to_owned() } else { format!("{name}_{part}") }
    };
    match node {
        Node::Scalar(value) => cells.push((name.to_owned(), value)),
        Node::Fields(fields) => {
            for (field, node) in fields {
                flatten(&part(&field), node, cells);
            }
        }
        Node::List(nodes) => {
            let interval = nodes.len() == 2;
            for (index, node) in nodes.into_iter().enumerate() {
                let element = match (interval, index) {
                    (true, 0) => part("low"),
                    (true, _) => part("high"),
                    (false, _) => part(&index.to_string()),
                };
                flatten(&element, node, cells);
            }
        }
    }
}

/// One line of names, then one line per record; see [`Row`] for the names.
///
/// A record that lacks a cell which another has leaves it empty, and so does null. Where a part with cells
/// of its own is null in some records, it has no column besides those.
pub fn to_csv(records: &[impl Serialize]) -> serde_json::Result<String> {
    let rows = records.iter().map(Row::of).collect::<Result<Vec<_>, _>>()?;
    let mut names = Vec::new();
    for (name, _) in rows.iter().flat_map(Row::cells) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let parts: Vec<&str> = names.clone();
    let is_part = |name: &str| {
        parts.iter().any(|other| other.strip_prefix(name).is_some_and(|rest| rest.starts_with('_')))
    };
    let is_null = |name: &str| rows.iter().all(|row| row.cell(name).is_none_or(Value::is_null));
    names.retain(|name| !(is_part(name) && is_null(name)));
    let mut text = line(names.iter().map(|name| quoted(name)));
    for row in &rows {
        text += &line(names.iter().map(|name| row.cell(name).map_or(String::new(), field)));
    }
    Ok(text)
}

fn line(fields: impl Iterator<Item = String>) -> String {
    fields.collect::<Vec<_>>().join(",") + "\n"
}

fn field(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => quoted(text),
        other => other.to_string(),
    }
}

/// Text in quotes, where it needs them.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nested_parts_become_cells_in_the_order_of_the_fields() {
        let row = Row::from_json(
            r#"{"steps":7,"success_ci95":[0.25,0.5],"by":{"z":1.5,"a":null},"counts":[1,2,3],"rule":"random"}"#,
        )
        .unwrap();
        let cells: Vec<String> =
            row.cells().map(|(name, value)| format!("{name}={value}")).collect();
        assert_eq!(
            cells,
            [
                "steps=7",
                "success_ci95_low=0.25",
                "success_ci95_high=0.5",
                "by_z=1.5",
                "by_a=null",
                "counts_0=1",
                "counts_1=2",
                "counts_2=3",
                "rule=\"random\"",
            ]
        );
        assert_eq!(row.number("by_z"), Some(1.5));
        assert_eq!(row.number("rule"), None);
        assert_eq!(row.numbers().count(), 7);
    }

    #[test]
    fn what_is_not_an_object_is_refused() {
        for text in ["3", "[1, 2]", "{", ""] {
            assert!(Row::from_json(text).is_err(), "{text}");
        }
    }

    #[derive(Serialize)]
    struct Record {
        name: &'static str,
        interval: [f64; 2],
        #[serde(skip_serializing_if = "Option::is_none")]
        extra: Option<u64>,
    }

    #[test]
    fn names_stand_once_and_values_in_their_columns() {
        let records = [
            Record { name: "plain", interval: [0.1, f64::NAN], extra: None },
            Record { name: "a, \"b\"", interval: [1.0, 2.0], extra: Some(3) },
        ];
        let expected = "name,interval_low,interval_high,extra\n\
                        plain,0.1,,\n\
                        \"a, \"\"b\"\"\",1.0,2.0,3\n";
        assert_eq!(to_csv(&records).unwrap(), expected);
    }

    #[test]
    fn a_part_that_is_null_in_some_records_has_no_column_of_its_own() {
        #[derive(Serialize)]
        struct Outer {
            part: Option<Part>,
        }
        #[derive(Serialize)]
        struct Part {
            a: u8,
        }
        let records = [Outer { part: None }, Outer { part: Some(Part { a: 1 }) }];
        assert_eq!(to_csv(&records).unwrap(), "part_a\n\n1\n");
    }
}
