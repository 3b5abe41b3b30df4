//! Files of numbers of 16 and of eight bits. Compiling proves each by double precision on 256 inputs.

use sortie_plans::ValueType;
use tract_onnx::pb::TensorProto;
use tract_onnx::pb::tensor_proto::DataType::{self, Bfloat16, Float, Float16, Int8};

use super::files::File;
use super::plans::{compiled, number};

/// A matrix of four columns, every number 0.25 of 16 bits.
fn half(mut file: File, kind: DataType) -> File {
    let bits: u16 = if kind == Float16 { 0x3400 } else { 0x3e80 };
    let tensor = file.0.initializer.last_mut().unwrap();
    tensor.data_type = kind as i32;
    let count = tensor.float_data.len();
    tensor.float_data.clear();
    tensor.raw_data = [bits.to_le_bytes(); 64][..count].concat();
    file
}

#[test]
fn numbers_of_16_bits_are_computed_in_32() {
    for kind in [Float16, Bfloat16] {
        let whole =
            half(File::default().input("x", kind, &["1", "4"]).layer("x", [4, 3], "q"), kind);
        let facts = compiled(&whole.output("q")).unwrap().facts;
        assert_eq!(facts.inputs[0].kind, ValueType::F32);
        let file = File::default().input("x", Float, &["1", "4"]);
        let file = file.node_with("Cast", &["x"], "narrow", vec![number("to", kind as i64)]);
        let file = half(file.layer("narrow", [4, 3], "sum"), kind);
        let file = file.node_with("Cast", &["sum"], "q", vec![number("to", Float as i64)]);
        let facts = compiled(&file.output("q")).unwrap().facts;
        assert_eq!(facts.parameters, 12);
    }
}

#[test]
fn weights_of_eight_bits_have_a_scale_for_each_column_where_the_file_names_no_axis() {
    for axis in [None, Some(1), Some(0), Some(-2)] {
        let mut file = File::default()
            .input("x", Float, &["1", "4"])
            .constant("scale", &[4], &[0.5, 0.25, 2.0, 0.125])
            .node_with(
                "DequantizeLinear",
                &["whole", "scale"],
                "weight",
                axis.map(|axis| number("axis", axis)).into_iter().collect(),
            )
            .node("MatMul", &["x", "weight"], "q");
        // As many rows as columns: either could have the scales.
        file.0.initializer.push(TensorProto {
            name: "whole".to_owned(),
            data_type: Int8 as i32,
            dims: vec![4, 4],
            int32_data: (-8..8).collect(),
            ..TensorProto::default()
        });
        let compiled = compiled(&file.output("q"));
        assert!(compiled.is_ok(), "{axis:?}: {}", compiled.unwrap_err());
    }
}
