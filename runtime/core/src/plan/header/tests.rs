use super::*;

fn header() -> Header {
    Header {
        layout: LAYOUT_TILES,
        arena_bytes: 9_000,
        arena_alignment: 64,
        n_max: 11,
        features: 58,
        actions: 12,
        hidden: 0,
        program_offset: 128,
        program_len: 40,
        weights_offset: 192,
        weights_len: 4_096,
        source: [7; 32],
        contract: 0x0123_4567_89ab_cdef,
        proof: Proof::Distance { max_distance: 2.5, inputs: 0x0201 },
        action_mismatch: 0.0,
        profile: Profile::Exact,
        network: Network::Agent,
        t_max: 6,
        arena_bytes_per_agent: 0x0403_0201,
        skip: false,
    }
}

#[test]
fn comes_back_as_it_was_written() {
    let checksums = Checksums { program: 1, weights: 2 };
    let bytes = header().to_bytes(checksums);
    assert_eq!(Header::read(&bytes), Ok((header(), checksums)));
    assert_eq!(arena_bytes(&bytes), 9_000);
}

#[test]
fn fields_stand_where_the_format_says() {
    let bytes = header().to_bytes(Checksums { program: 0xaabb_ccdd, weights: 0x1122_3344 });
    assert_eq!(&bytes[..16], b"SORTIEPL\x02\0\x03\0\x04\x03\x02\x01");
    assert_eq!(bytes[16..20], 1_u32.to_le_bytes());
    assert_eq!(bytes[28..32], 11_u32.to_le_bytes());
    assert_eq!(bytes[44..48], 128_u32.to_le_bytes());
    assert_eq!(bytes[60..64], 0xaabb_ccdd_u32.to_le_bytes());
    assert_eq!(bytes[64..68], 0x1122_3344_u32.to_le_bytes());
    assert_eq!(bytes[68..100], [7; 32]);
    assert_eq!(bytes[108..112], 2.5_f32.to_le_bytes());
    assert_eq!(bytes[116..120], [0, 0, 6, 0]);
    assert_eq!(bytes[120..124], [1, 2, 3, 4]);
    assert_eq!(bytes[124..], [0, 0, 1, 2]);
}

#[test]
fn a_plan_with_a_skip_says_so() {
    let with = Header { skip: true, ..header() };
    let bytes = with.to_bytes(Checksums::default());
    assert_eq!(bytes[124..126], [1, 0]);
    assert_eq!(Header::read(&bytes), Ok((with, Checksums::default())));
}

#[test]
fn plans_of_before_say_their_error_and_go_on_saying_it() {
    let before = Header { proof: Proof::Error { max_rel_error: 1.5e-7 }, ..header() };
    let mut bytes = before.to_bytes(Checksums::default());
    assert_eq!((&bytes[8..12], &bytes[124..]), (&[2, 0, 2, 0][..], &[0; 4][..]));
    for minor in 0..=2 {
        bytes[10] = minor;
        assert_eq!(Header::read(&bytes), Ok((before, Checksums::default())), "{minor}");
    }
}

#[test]
fn refuses_what_it_cannot_read() {
    let bytes = header().to_bytes(Checksums::default());
    let with = |at: usize, value: u8| {
        let mut changed = bytes;
        changed[at] = value;
        Header::read(&changed).map(|_| ())
    };
    assert_eq!(with(0, b'X'), Err(PlanError::BadMagic));
    assert_eq!(with(8, 1), Err(PlanError::Version { major: 1, minor: 3 }));
    assert_eq!(with(10, 4), Err(PlanError::Version { major: 2, minor: 4 }));
    assert_eq!(with(124, 2), Err(PlanError::UnknownOp));
    assert_eq!(with(12, 1), Err(PlanError::Endian));
    assert_eq!(with(116, 9), Err(PlanError::WrongProfile { got: 9 }));
    assert_eq!(Header::read(&bytes[..127]), Err(PlanError::Truncated { need: 128, got: 127 }));
    assert_eq!(Header::read(b"SORTIE"), Err(PlanError::Truncated { need: 128, got: 6 }));
    assert_eq!(Header::read(b"# a text file"), Err(PlanError::BadMagic));
}
