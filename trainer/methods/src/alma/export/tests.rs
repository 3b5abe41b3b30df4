//! A team-value network as a file.

use sortie_learn::export::attention::ExportError;
use sortie_learn::export::{TeamValueExport, team_value_onnx};

use sortie_learn::networks::Targets;

use crate::alma::agents::{UtilityShape, network};

const FEATURES: usize = 6;
const RELATIONS: usize = 3;

fn export(relations: usize) -> Result<Vec<u8>, ExportError> {
    let input = FEATURES + 2 + RELATIONS;
    let (skip, targets) = (false, Targets::default());
    let shape = UtilityShape { input, width: 16, heads: 2, base: 8, actions: 1, skip, targets };
    let network = network(shape, 8.0, 7);
    let (features, contract) = (FEATURES, 0x0123_4567_89ab_cdef);
    let layers = network.view().layers();
    team_value_onnx(&TeamValueExport { features, relations, contract, layers })
}

#[test]
fn a_network_becomes_the_recorded_file() {
    let path = "/../../tests/golden/onnx/team_value_small.onnx";
    let path = format!("{}{path}", env!("CARGO_MANIFEST_DIR"));
    let recorded = std::fs::read(path).unwrap();
    assert!(export(RELATIONS).unwrap() == recorded, "the exported bytes changed");
}

#[test]
fn columns_that_do_not_add_up_are_refused() {
    let error = export(4).unwrap_err();
    assert_eq!(error, ExportError::Columns { want: 12, got: 11 });
}
