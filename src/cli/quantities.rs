//! Quantities on the command line: a number and its unit.

/// In bytes.
pub(crate) fn size(text: &str) -> Result<u64, String> {
    const UNITS: [(&str, f64); 4] = [("GB", 1e9), ("MB", 1e6), ("kB", 1e3), ("B", 1.0)];
    measure(text, &UNITS)
}

/// In nanoseconds.
pub(crate) fn time(text: &str) -> Result<u64, String> {
    const UNITS: [(&str, f64); 4] = [("ms", 1e6), ("s", 1e9), ("min", 60e9), ("h", 3600e9)];
    measure(text, &UNITS)
}

/// A number with its unit, in the smallest one.
fn measure(text: &str, units: &[(&str, f64)]) -> Result<u64, String> {
    let digits = text.find(|letter: char| letter.is_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let factor = units.iter().find(|(name, _)| *name == unit).map(|(_, factor)| factor);
    let number: Option<f64> = number.trim().parse().ok();
    let all = number.zip(factor).map(|(number, factor)| number * factor);
    all.filter(|all| (1.0..9e18).contains(all)).map(|all| all as u64).ok_or_else(|| {
        let units: Vec<_> = units.iter().map(|(name, _)| *name).collect();
        format!("a number and its unit are wanted, one of {}", units.join(", "))
    })
}
