//! Records as comma-separated values (RFC 4180).

use serde::Serialize;
use serde_json::Value;

use super::Row;

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
