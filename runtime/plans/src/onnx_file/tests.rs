use super::*;

fn message(fields: &[(u64, &[u8])]) -> Vec<u8> {
    let mut message = Vec::new();
    fields.iter().for_each(|(number, content)| put(&mut message, *number, content));
    message
}

fn number(number: u64, value: u64) -> Vec<u8> {
    let mut field = Vec::new();
    put_number(&mut field, number << 3);
    put_number(&mut field, value);
    field
}

/// A file with one tensor inside and one elsewhere.
fn model(place: &[(&str, &str)]) -> Vec<u8> {
    let inside = message(&[(8, b"bias"), (RAW_DATA, &[7; 200])]);
    let mut outside = message(&[(8, b"weight")]);
    for (key, value) in place {
        let pair = message(&[(KEY, key.as_bytes()), (VALUE, value.as_bytes())]);
        put(&mut outside, EXTERNAL_DATA, &pair);
    }
    outside.extend(number(DATA_LOCATION, EXTERNAL));
    let graph = message(&[(2, b"policy"), (INITIALIZER, &inside), (INITIALIZER, &outside)]);
    [number(1, 8), message(&[(GRAPH, &graph), (3, b"")])].concat()
}

fn read(place: &[(&str, &str)]) -> io::Result<Vec<u8>> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("policy.onnx");
    fs::write(folder.path().join("policy.onnx.data"), [1, 2, 3, 4, 5, 6])?;
    fs::create_dir(folder.path().join("inner"))?;
    fs::write(&path, model(place))?;
    read_onnx(&path)
}

#[test]
fn weights_beside_a_file_are_put_into_it() {
    let place = [("location", "policy.onnx.data"), ("offset", "2"), ("length", "3")];
    let weight = message(&[(8, b"weight"), (RAW_DATA, &[3, 4, 5])]);
    let bias = message(&[(8, b"bias"), (RAW_DATA, &[7; 200])]);
    let graph = message(&[(2, b"policy"), (INITIALIZER, &bias), (INITIALIZER, &weight)]);
    let whole = [number(1, 8), message(&[(GRAPH, &graph), (3, b"")])].concat();
    assert_eq!(read(&place).unwrap(), whole);
    // Without a length, up to the end.
    let weight = message(&[(8, b"weight"), (RAW_DATA, &[1, 2, 3, 4, 5, 6])]);
    assert!(read(&place[..1]).unwrap().windows(weight.len()).any(|bytes| bytes == weight));
}

#[test]
fn places_that_are_not_there_are_refused() {
    let data = ("location", "policy.onnx.data");
    for (place, words) in [
        (vec![], "no name"),
        (vec![("location", "../policy.onnx.data")], "no name"),
        (vec![("location", "/etc/hostname")], "no name"),
        (vec![("location", "other.data")], "same folder"),
        (vec![("location", "inner")], "no file"),
        (vec![data, ("offset", "7")], "fewer bytes"),
        (vec![data, ("length", "7")], "fewer bytes"),
        (vec![data, ("offset", "2"), ("length", "-1")], "fewer bytes"),
    ] {
        let error = read(&place).unwrap_err();
        let is_missing = words == "same folder";
        let kind = if is_missing { io::ErrorKind::NotFound } else { io::ErrorKind::InvalidData };
        assert_eq!(error.kind(), kind, "{place:?}");
        assert!(error.to_string().contains(words), "{place:?}: {error}");
    }
}

#[test]
fn other_files_come_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    let whole = model(&[]);
    let inside = message(&[(GRAPH, &message(&[(INITIALIZER, &message(&[(RAW_DATA, &[1])]))]))]);
    let cut = &whole[..whole.len() - 3];
    for bytes in [b"SORTIEPL plan".as_slice(), b"", &[0xff; 30], cut, &inside] {
        fs::write(&path, bytes).unwrap();
        assert!(read_plan_or_onnx(&path).is_ok_and(|read| read == bytes), "{bytes:?}");
    }
    assert!(read_plan_or_onnx(folder.path()).is_err());
}

#[test]
fn files_of_other_formats_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let safetensors = [&4_u64.to_le_bytes()[..], b"{  }", &[0; 8]].concat();
    for (name, bytes, word) in [
        (
            "policy.onnx",
            b"version https://git-lfs.github.com/spec/v1\noid sha256:0".to_vec(),
            "git lfs pull",
        ),
        ("policy.pt", b"PK\x03\x04 an archive".to_vec(), "TorchScript"),
        ("policy.safetensors", safetensors, "safetensors"),
        ("policy.nn", vec![16, 0, 0, 0], "Barracuda"),
        ("policy.plan", b"SORTIEPL and more".to_vec(), "is a plan"),
    ] {
        let path = folder.path().join(name);
        fs::write(&path, bytes).expect("a file");
        let error = read_onnx(&path).expect_err("is no ONNX file").to_string();
        assert!(error.contains(word), "{error}");
    }
}
