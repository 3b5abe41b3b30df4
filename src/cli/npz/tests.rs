use super::*;

/// An `.npy` file.
fn npy(kind: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16).to_le_bytes());
    file.extend(header.as_bytes());
    file.extend(data);
    file
}

/// A zip archive of one file.
fn zip(name: &str, file: &[u8]) -> Vec<u8> {
    let (length, name_bytes) =
        ((file.len() as u32).to_le_bytes(), (name.len() as u16).to_le_bytes());
    let mut archive = b"PK\x03\x04".to_vec();
    archive.extend([0; 14]);
    archive.extend(length.repeat(2));
    archive.extend(name_bytes);
    archive.extend([0; 2]);
    archive.extend(name.as_bytes());
    archive.extend(file);
    let directory = (archive.len() as u32).to_le_bytes();
    archive.extend(b"PK\x01\x02");
    archive.extend([0; 16]);
    archive.extend(length.repeat(2));
    archive.extend(name_bytes);
    archive.extend([0; 16]);
    archive.extend(name.as_bytes());
    archive.extend(b"PK\x05\x06");
    archive.extend([0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0, 0]);
    archive.extend(directory);
    archive.extend([0; 2]);
    archive
}

fn only(kind: &str, shape: &str, data: &[u8]) -> Result<Array, String> {
    arrays(&zip("a.npy", &npy(kind, shape, data))).map(|mut arrays| arrays.remove("a").unwrap())
}

#[test]
fn every_type_is_read_with_its_shape() {
    let two = |shape: &[usize], numbers: &[f32]| {
        Ok(Array { shape: shape.to_vec(), numbers: numbers.to_vec() })
    };
    let bytes = |one: &[u8], other: &[u8]| [one, other].concat();
    let (f1, f2) = (1.5_f32.to_le_bytes(), (-2.0_f32).to_le_bytes());
    assert_eq!(only("<f4", "(2,)", &bytes(&f1, &f2)), two(&[2], &[1.5, -2.0]));
    let halves = [[0x00, 0x3e], [0x00, 0xc0], [0x01, 0x00], [0x00, 0xfc]].concat();
    let numbers = [1.5, -2.0, 5.960_464_5e-8, f32::NEG_INFINITY];
    assert_eq!(only("<f2", "(4,)", &halves), two(&[4], &numbers));
    let (d1, d2) = (0.25_f64.to_le_bytes(), 3.0_f64.to_le_bytes());
    assert_eq!(only("<f8", "(1, 2)", &bytes(&d1, &d2)), two(&[1, 2], &[0.25, 3.0]));
    let (i1, i2) = (7_i64.to_le_bytes(), (-1_i64).to_le_bytes());
    assert_eq!(only("<i8", "(2, 1)", &bytes(&i1, &i2)), two(&[2, 1], &[7.0, -1.0]));
    let (i1, i2) = (7_i32.to_le_bytes(), (-1_i32).to_le_bytes());
    assert_eq!(only("<i4", "(2,)", &bytes(&i1, &i2)), two(&[2], &[7.0, -1.0]));
    assert_eq!(only("|b1", "(2,)", &[0, 1]), two(&[2], &[0.0, 1.0]));
    assert_eq!(only("|u1", "()", &[200]), two(&[], &[200.0]));
}

#[test]
fn what_is_not_read_is_said_with_what_helps() {
    let refused = |result: Result<Array, String>, words: &str| {
        let reason = result.unwrap_err();
        assert!(reason.contains(words), "{reason}");
    };
    refused(only("<c8", "(1,)", &[0; 8]), "float32");
    refused(only("<f4", "(3,)", &[0; 8]), "no array");
    refused(only("<f4", "(18446744073709551615, 2)", &[0; 8]), "no array");
    let mut columns = npy("<f4", "(2,)", &[0; 8]);
    let order = columns.windows(5).position(|bytes| bytes == b"False").unwrap();
    columns[order..order + 5].copy_from_slice(b"True ");
    refused(arrays(&zip("a.npy", &columns)).map(|_| unreachable!()), "ascontiguousarray");
    let mut compressed = zip("a.npy", &npy("<f4", "(2,)", &[0; 8]));
    let directory = compressed.windows(4).position(|bytes| bytes == b"PK\x01\x02").unwrap();
    compressed[directory + 10] = 8;
    assert!(arrays(&compressed).unwrap_err().contains("numpy.savez"));
}

#[test]
fn a_cut_or_damaged_archive_is_refused_or_read_but_never_trusted() {
    let whole = zip("a.npy", &npy("<f4", "(2,)", &[0; 8]));
    assert!(arrays(&whole).is_ok());
    for length in 0..whole.len() {
        assert!(arrays(&whole[..length]).is_err(), "{length}");
    }
    for at in 0..whole.len() {
        for value in [0, 1, 0x7F, 0xFF] {
            let mut damaged = whole.clone();
            damaged[at] = value;
            let _ = arrays(&damaged);
        }
    }
}
