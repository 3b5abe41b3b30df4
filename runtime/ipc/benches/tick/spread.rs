//! Medians and what they spread over.

fn quantile(sorted: &[f64], q: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * q).round() as usize]
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

pub(crate) fn median(values: &[f64]) -> f64 {
    quantile(&sorted(values), 0.5)
}

/// The ratios of values measured in the same rounds.
pub(crate) fn ratios(values: &[f64], of: &[f64]) -> Vec<f64> {
    values.iter().zip(of).map(|(value, of)| value / of).collect()
}

/// Median and interquartile range.
pub(crate) fn spread(values: &[f64], scale: f64, unit: &str) -> String {
    let sorted = sorted(values);
    let [low, middle, high] = [0.25, 0.5, 0.75].map(|q| quantile(&sorted, q) * scale);
    format!("{middle:.2}{unit} ({low:.2} to {high:.2})")
}
