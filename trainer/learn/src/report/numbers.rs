//! Numbers as people read them.

/// A count in at most four figures: `950`, `50 k`, `1.25 M`.
pub fn count(value: f64) -> String {
    let (divisor, unit) = match value.abs() {
        size if size >= 999_500_000.0 => (1e9, " G"),
        size if size >= 999_500.0 => (1e6, " M"),
        size if size >= 9_999.5 => (1e3, " k"),
        _ => (1.0, ""),
    };
    format!("{}{unit}", trimmed(value / divisor))
}

/// A duration in the unit that suits it: `45 s`, `12.5 min`, `3.2 h`.
pub fn duration(seconds: f64) -> String {
    let unit = TimeUnit::fitting(seconds);
    format!("{} {}", trimmed(seconds / unit.seconds), unit.name)
}

/// Three figures, without zeros at the end of a fraction.
fn trimmed(value: f64) -> String {
    let places = match value.abs() {
        size if size >= 99.95 => 0,
        size if size >= 9.995 => 1,
        _ => 2,
    };
    let text = format!("{value:.places$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// A unit of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeUnit {
    /// Its seconds.
    pub seconds: f64,
    /// Its symbol.
    pub name: &'static str,
    /// Its plural.
    pub plural: &'static str,
}

impl TimeUnit {
    /// The unit for durations up to `seconds`.
    pub fn fitting(seconds: f64) -> Self {
        match seconds {
            s if s < 120.0 => Self { seconds: 1.0, name: "s", plural: "seconds" },
            s if s < 7200.0 => Self { seconds: 60.0, name: "min", plural: "minutes" },
            _ => Self { seconds: 3600.0, name: "h", plural: "hours" },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_durations_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (950.0, "950"),
            (5000.0, "5000"),
            (50_000.0, "50 k"),
            (62_500.0, "62.5 k"),
            (999_999.0, "1 M"),
            (1_250_000.0, "1.25 M"),
        ] {
            assert_eq!(count(value), text);
        }
        for (value, text) in [(45.0, "45 s"), (750.0, "12.5 min"), (11_520.0, "3.2 h")] {
            assert_eq!(duration(value), text);
        }
    }
}
