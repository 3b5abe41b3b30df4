//! Operators that few policies have: each is compiled alone, and compiling proves it by double precision on 256 inputs.

use tract_onnx::pb::AttributeProto;
use tract_onnx::pb::tensor_proto::DataType::{Float, Int64};

use super::files::File;
use super::plans::{compiled, number, steps};

fn picture() -> File {
    File::default().input("x", Float, &["1", "3", "4"])
}

fn compiles(what: &str, file: File) {
    let compiled = compiled(&file);
    assert!(compiled.is_ok(), "{what}: {}", compiled.unwrap_err());
}

#[test]
fn functions_of_a_part_of_all_numbers() {
    for operator in ["Asin", "Acos", "Atanh"] {
        let file = picture().node("Tanh", &["x"], "small").node(operator, &["small"], "q");
        compiles(operator, file.output("q"));
    }
    let positive = || picture().node("Abs", &["x"], "size").constant("one", &[], &[1.5]);
    let above = || positive().node("Add", &["size", "one"], "above");
    compiles("Acosh", above().node("Acosh", &["above"], "q").output("q"));
    for exponent in [0.3, -1.7, 9.0] {
        let file = above().constant("n", &[], &[exponent]).node("Pow", &["above", "n"], "q");
        compiles("Pow", file.output("q"));
    }
    // Powers of numbers below zero are none.
    let file = picture().constant("n", &[], &[0.3]).node("Pow", &["x", "n"], "q");
    compiles("Pow", file.output("q"));
    compiles("Pow", above().node("Pow", &["one", "x"], "q").output("q"));
}

#[test]
fn whole_numbers_are_divided_and_have_remainders() {
    for (operator, divisor) in [("Div", 3), ("Mod", 3), ("Div", -2), ("Mod", -2)] {
        let file = File::default()
            .input("n", Int64, &["1", "4"])
            .whole("by", &[divisor])
            .node(operator, &["n", "by"], "parts")
            .node_with("Cast", &["parts"], "q", vec![number("to", Float as i64)]);
        compiles(operator, file.output("q"));
    }
    let file = picture().constant("by", &[], &[0.7]);
    let file = file.node_with("Mod", &["x", "by"], "q", vec![number("fmod", 1)]);
    compiles("Mod", file.output("q"));
}

#[test]
fn the_largest_of_a_row_come_one_after_the_other() {
    for (count, axis, largest) in [(1, 2, 1), (3, 2, 1), (2, 1, 0), (4, -1, 0)] {
        for output in ["numbers", "places"] {
            let attributes = vec![number("axis", axis), number("largest", largest)];
            let file = picture()
                .whole("count", &[count])
                .nodes("TopK", &["x", "count"], &["numbers", "places"], attributes)
                .node_with("Cast", &[output], "q", vec![number("to", Float as i64)]);
            compiles(output, file.output("q"));
        }
    }
    let many = File::default().input("x", Float, &["1", "20"]).whole("count", &[17]).nodes(
        "TopK",
        &["x", "count"],
        &["q", "places"],
        vec![],
    );
    let refused = compiled(&many.output("q")).unwrap_err().to_string();
    assert!(refused.contains("at most 16"), "{refused}");
}

#[test]
fn running_sums_go_both_ways() {
    for (axis, exclusive, reverse) in [(2, 0, 0), (2, 1, 0), (2, 0, 1), (1, 1, 1)] {
        let attributes = vec![number("exclusive", exclusive), number("reverse", reverse)];
        let mut file = picture().whole("axis", &[axis]);
        file.0.initializer[0].dims.clear();
        let file = file.node_with("CumSum", &["x", "axis"], "q", attributes);
        compiles("CumSum", file.output("q"));
    }
}

fn text(name: &str, text: &str) -> AttributeProto {
    AttributeProto { s: text.into(), r#type: 3, ..number(name, 0) }
}

#[test]
fn pictures_are_made_larger_and_smaller_between_their_points() {
    const HOW: &str = "coordinate_transformation_mode";
    let picture = || File::default().input("x", Float, &["1", "2", "7", "5"]);
    for how in ["half_pixel", "pytorch_half_pixel", "align_corners", "asymmetric"] {
        for sizes in [[1, 2, 3, 4], [1, 2, 7, 9], [1, 2, 16, 1]] {
            let attributes = vec![text("mode", "linear"), text(HOW, how)];
            let file = picture().whole("sizes", &sizes);
            let file = file.node_with("Resize", &["x", "", "", "sizes"], "q", attributes);
            compiles(how, file.output("q"));
        }
    }
    let file = picture().constant("scales", &[4], &[1.0, 1.0, 1.7, 0.6]);
    let file = file.node_with("Resize", &["x", "", "scales"], "q", vec![text("mode", "linear")]);
    assert!(steps(&file.output("q")).contains(&"DenseRows"));
    // Channels behind the points, and the sizes computed from those of the picture.
    let file = picture()
        .whole("end", &[2])
        .whole("start", &[0])
        .whole("new", &[4, 5])
        .node("Shape", &["x"], "shape")
        .node("Slice", &["shape", "start", "end"], "first")
        .node_with("Concat", &["first", "new"], "sizes", vec![number("axis", 0)])
        .node_with("Resize", &["x", "", "", "sizes"], "q", vec![text("mode", "linear")]);
    compiles("sizes that are computed", file.output("q"));
    let cubic = picture().whole("sizes", &[1, 2, 3, 4]);
    let cubic =
        cubic.node_with("Resize", &["x", "", "", "sizes"], "q", vec![text("mode", "cubic")]);
    assert!(compiled(&cubic.output("q")).is_err(), "other weights than the two nearest");
}

#[test]
fn rows_are_taken_from_and_added_to_computed_places() {
    let ends = || {
        File::default()
            .input("x", Float, &["2", "3"])
            .input("ends", Int64, &["4"])
            .input("new", Float, &["4", "3"])
            .whole("axis", &[-1])
            .node("Unsqueeze", &["ends", "axis"], "places")
    };
    let file = ends().node("GatherND", &["x", "places"], "rows").node("Add", &["rows", "new"], "q");
    compiles("GatherND", file.output("q"));
    let add = || vec![text("reduction", "add")];
    let file = ends().node_with("ScatterND", &["x", "places", "new"], "q", add());
    compiles("ScatterND", file.output("q"));
    let file = ends().node("ScatterND", &["x", "places", "new"], "q");
    assert!(compiled(&file.output("q")).is_err(), "which of several rows stays is not said");
    let constant = File::default()
        .input("x", Float, &["2", "3"])
        .input("new", Float, &["3", "3"])
        .whole("places", &[1, 0, 1]);
    let mut constant = constant.node_with("ScatterND", &["x", "places", "new"], "q", add());
    constant.0.initializer[0].dims = vec![3, 1];
    compiles("ScatterND", constant.output("q"));
}

#[test]
fn numbers_move_to_places_that_are_constant() {
    let constant = |name: &str, sizes: &[usize], places: &[i64]| {
        let mut file = picture().whole(name, places);
        let sizes = sizes.iter().map(|size| *size as i64).collect();
        file.0.initializer.last_mut().unwrap().dims = sizes;
        file
    };
    for mode in ["edge", "reflect"] {
        let file = picture().whole("pads", &[0, 1, 2, 0, 1, 3]);
        let file = file.node_with("Pad", &["x", "pads"], "q", vec![text("mode", mode)]);
        assert!(steps(&file.output("q")).contains(&"Arrange"), "{mode}");
    }
    compiles(
        "Tile",
        picture().whole("times", &[1, 2, 3]).node("Tile", &["x", "times"], "q").output("q"),
    );
    let backwards = picture()
        .whole("start", &[-1])
        .whole("end", &[-9])
        .whole("axis", &[2])
        .whole("step", &[-1]);
    compiles(
        "Slice",
        backwards.node("Slice", &["x", "start", "end", "axis", "step"], "q").output("q"),
    );
    // Every so many from one on: where that is no multiple, the first ones are skipped.
    for (axis, start, step) in [(2, 1, 2), (2, 2, 3), (1, 1, 2)] {
        let strided = picture()
            .whole("start", &[start])
            .whole("end", &[9])
            .whole("axis", &[axis])
            .whole("step", &[step]);
        let file = strided.node("Slice", &["x", "start", "end", "axis", "step"], "q").output("q");
        compiles("Slice", file);
    }
    let file = constant("places", &[1, 3, 2], &[0, -1, 2, 2, 1, 3]);
    let file = file.node_with("GatherElements", &["x", "places"], "q", vec![number("axis", 2)]);
    compiles("GatherElements", file.output("q"));
    let file = constant("places", &[2, 2], &[0, 1, 0, 2]);
    compiles("GatherND", file.node("GatherND", &["x", "places"], "q").output("q"));
    let file = constant("places", &[1, 2], &[0, 1]).input("new", Float, &["1", "4"]);
    compiles("ScatterND", file.node("ScatterND", &["x", "places", "new"], "q").output("q"));
    let file = constant("places", &[1, 1, 2], &[3, 1]).input("new", Float, &["1", "1", "2"]);
    let file =
        file.node_with("ScatterElements", &["x", "places", "new"], "q", vec![number("axis", 2)]);
    compiles("ScatterElements", file.output("q"));
    let file = File::default()
        .input("x", Float, &["1", "2", "3", "3"])
        .constant("scales", &[4], &[1.0, 1.0, 2.0, 2.0])
        .node_with("Resize", &["x", "", "scales"], "q", vec![text("mode", "nearest")]);
    compiles("Resize", file.output("q"));
}

#[test]
fn computed_places_choose_one_number_of_every_row() {
    let chosen = |keep: i64| {
        let attributes = vec![number("axis", -1), number("keepdims", keep)];
        picture().input("y", Float, &["1", "3", "4"]).node_with(
            "ArgMax",
            &["x"],
            "best",
            attributes,
        )
    };
    let file = chosen(1).node_with("GatherElements", &["y", "best"], "q", vec![number("axis", 2)]);
    compiles("GatherElements", file.output("q"));
    let file = chosen(1).node_with("GatherND", &["y", "best"], "q", vec![number("batch_dims", 2)]);
    compiles("GatherND", file.output("q"));
    let file = chosen(1).node_with("GatherElements", &["y", "best"], "q", vec![number("axis", 1)]);
    let refused = compiled(&file.output("q")).unwrap_err().to_string();
    assert!(refused.contains("some rows only"), "{refused}");
}

/// Whole numbers from -3 to 3 of so many features.
fn counted(count: &str) -> File {
    File::default()
        .input("x", Float, &["1", count])
        .constant("times", &[], &[3.5])
        .node("Mul", &["x", "times"], "wide")
        .node_with("Cast", &["wide"], "n", vec![number("to", Int64 as i64)])
}

#[test]
fn rows_of_tables_are_looked_up() {
    let table: Vec<f32> = (0..42).map(|number| (number * number % 17) as f32 - 8.0).collect();
    for (sizes, axis) in [([7, 3, 2], 0), ([2, 7, 3], 1), ([2, 3, 7], 2)] {
        let file = counted("3").whole("back", &[3]).constant("table", &sizes, &table);
        // Numbers that count from the end, and others that do not.
        for index in ["n", "m"] {
            let file = File(file.0.clone()).node("Add", &["n", "back"], "m");
            let file = file.node_with("Gather", &["table", index], "q", vec![number("axis", axis)]);
            let found = steps(&file.output("q"));
            assert!(found.contains(&"LookUp") && !found.contains(&"Multiply"), "{found:?}");
        }
    }
    // A table that is computed.
    let file = counted("7").input("me", Int64, &["1"]);
    let file = file.node_with("Gather", &["x", "me"], "q", vec![number("axis", 1)]).output("q");
    assert!(steps(&file).contains(&"LookUp"));
}

#[test]
fn a_layer_on_zeros_and_a_one_is_a_table() {
    let weights = |count: usize| (0..count).map(|n| (n * 7 % 11) as f32 - 5.0).collect::<Vec<_>>();
    let one_hot = || {
        let file = counted("1").whole("depth", &[3]).constant("both", &[2], &[0.0, 1.0]);
        file.node("OneHot", &["n", "depth", "both"], "hot")
    };
    let equal = || {
        let file = counted("1").whole("places", &[0, 1, 2]);
        let cast = vec![number("to", Float as i64)];
        file.node("Equal", &["places", "n"], "is").node_with("Cast", &["is"], "hot", cast)
    };
    for (file, relu) in [(one_hot(), true), (one_hot(), false), (equal(), true), (equal(), false)] {
        let mut file = file
            .constant("weights", &[3, 5], &weights(15))
            .constant("bias", &[5], &[0.5, -1.0, 2.0, 0.25, -0.5])
            .node("MatMul", &["hot", "weights"], "product")
            .node("Add", &["product", "bias"], if relu { "sum" } else { "q" });
        if relu {
            file = file.node("Relu", &["sum"], "q");
        }
        let found = steps(&file.output("q"));
        assert!(found.contains(&"LookUp"), "{found:?}");
        let others = ["Dense", "Combine", "Select", "Constant"];
        assert!(!found.iter().any(|step| others.contains(step)), "{found:?}");
    }
}
