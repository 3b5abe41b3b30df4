//! Networks and learners of ALMA against the reference's modules, on recorded inputs (`tests/golden`).

mod allocation;
mod coach;
mod files;
mod low_level;
mod networks;
mod popart;
mod reference;
mod windows;

fn assert_close(what: &str, got: &[f32], want: &[f64]) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (index, (got, want)) in got.iter().zip(want).enumerate() {
        let error = (f64::from(*got) - want).abs();
        assert!(error <= 1e-5 + 1e-5 * want.abs(), "{what}[{index}]: {got} against {want}");
    }
}
