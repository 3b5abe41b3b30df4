use std::vec;
use std::vec::Vec;

use super::*;

const SCHEMA: u64 = 0x0102_0304_0506_0708;

fn format() -> ServedFormat {
    ServedFormat::new(SCHEMA, 3, 2, 5).expect("within limits")
}

/// Bytes at an address that heads may have.
fn aligned(length: usize) -> Vec<u64> {
    vec![0; length.div_ceil(8)]
}

fn observation() -> Vec<u64> {
    let format = format();
    let mut words = aligned(format.observation_bytes());
    let head = ObservationHead {
        session: 7,
        seq: 8,
        t_ns: 9,
        deadline_ns: 10,
        episode: 11,
        ..ObservationHead::default()
    };
    let (inputs, available) = ([&[1.0, 2.0][..], &[3.0]], [1, 0, 1, 0, 1]);
    let to = &mut words.as_mut_bytes()[..format.observation_bytes()];
    format.write_observation(&head, &inputs, &available, to).expect("the format's lengths");
    words
}

fn answer() -> Vec<u64> {
    let format = format();
    let mut words = aligned(format.answer_bytes());
    let head = AnswerHead { session: 7, seq: 8, action: -1, status: 3, ..AnswerHead::default() };
    let to = &mut words.as_mut_bytes()[..format.answer_bytes()];
    format.write_answer(&head, &[0.5, -0.5], to).expect("the format's lengths");
    words
}

#[test]
fn messages_stand_byte_for_byte_as_documented() {
    let format = format();
    assert_eq!((format.observation_bytes(), format.answer_bytes()), (88, 72));
    let words = observation();
    let bytes = words.as_bytes();
    assert_eq!(bytes[..8], *b"SOBS\x03\0\0\0");
    assert_eq!(bytes[8..16], SCHEMA.to_le_bytes());
    let numbers: Vec<u64> = words[2..6].to_vec();
    assert_eq!(numbers, [7, 8, 9, 10]);
    assert_eq!(words[6..8], [11 | 3 << 32, 5]);
    assert_eq!(bytes[64..76], [1.0_f32, 2.0, 3.0].map(f32::to_le_bytes).concat());
    assert_eq!(bytes[76..88], [1_u16, 0, 1, 0, 1, 0].map(u16::to_le_bytes).concat());
    let words = answer();
    let bytes = words.as_bytes();
    assert_eq!(bytes[..8], *b"SACT\x03\0\0\0");
    assert_eq!(bytes[44..48], [0xFF; 4]);
    assert_eq!(bytes[48..56], [3, 0, 0, 0, 2, 0, 0, 0]);
    assert_eq!(bytes[64..72], [0.5_f32, -0.5].map(f32::to_le_bytes).concat());
}

#[test]
fn what_is_written_is_read_again() {
    let (format, words) = (format(), observation());
    let bytes = &words.as_bytes()[..format.observation_bytes()];
    let read = format.read_observation(bytes).expect("sound");
    assert_eq!((read.inputs, read.available), (&[1.0, 2.0, 3.0][..], &[1, 0, 1, 0, 1][..]));
    assert_eq!((read.head.session, read.head.seq, read.head.episode), (7, 8, 11));
    assert_eq!(ObservationHead::of(bytes), Some(read.head));
    let words = answer();
    let read = format.read_answer(&words.as_bytes()[..format.answer_bytes()]).expect("sound");
    assert_eq!((read.outputs, read.head.action), (&[0.5, -0.5][..], -1));
}

#[test]
fn cut_off_longer_and_misaligned_bytes_are_refused() {
    let format = format();
    let mut words = observation();
    words.push(0);
    let bytes = words.as_bytes();
    for length in (0..bytes.len()).filter(|&length| length != format.observation_bytes()) {
        let refused = format.read_observation(&bytes[..length]).map(|_| ());
        assert_eq!(refused, Err(MessageError::Length), "{length}");
    }
    let refused = format.read_observation(&bytes[4..4 + format.observation_bytes()]).map(|_| ());
    assert_eq!(refused, Err(MessageError::Length));
    let mut words = answer();
    words.push(0);
    let bytes = words.as_bytes();
    for length in (0..bytes.len()).filter(|&length| length != format.answer_bytes()) {
        let refused = format.read_answer(&bytes[..length]).map(|_| ());
        assert_eq!(refused, Err(MessageError::Length), "{length}");
    }
}

/// What a changed byte of the head may do: nothing, or a refusal. The counts, magic, ABI and schema are held to.
#[test]
fn every_changed_byte_of_a_head_is_refused_or_means_nothing_for_lengths() {
    let format = format();
    let held = |place: usize, counts: std::ops::Range<usize>| {
        place < 6 || (8..16).contains(&place) || counts.contains(&place)
    };
    for place in 0..64 {
        for bit in 0..8 {
            let mut words = observation();
            words.as_mut_bytes()[place] ^= 1 << bit;
            let read = format.read_observation(words.as_bytes());
            assert_eq!(read.is_err(), held(place, 52..60), "byte {place} of an observation");
            let mut words = answer();
            words.as_mut_bytes()[place] ^= 1 << bit;
            let read = format.read_answer(words.as_bytes());
            assert_eq!(read.is_err(), held(place, 52..56), "byte {place} of an answer");
        }
    }
}

#[test]
fn what_does_not_fit_the_format_is_not_written() {
    let format = format();
    let (head, mut bytes) = (ObservationHead::default(), vec![0; format.observation_bytes() + 4]);
    let (end, mask) = (format.observation_bytes(), [1; 5]);
    let write = |inputs: &[&[f32]], mask: &[u16], to: &mut [u8]| {
        format.write_observation(&head, inputs, mask, to)
    };
    let refused = Err(MessageError::Length);
    assert_eq!(write(&[&[1.0; 2]], &mask, &mut bytes[..end]), refused);
    assert_eq!(write(&[&[1.0; 3]], &mask[1..], &mut bytes[..end]), refused);
    assert_eq!(write(&[&[1.0; 3]], &mask, &mut bytes), refused);
    assert_eq!(write(&[&[1.0; 3]], &mask, &mut bytes[..end]), Ok(()));
    let write =
        |outputs: &[f32], to: &mut [u8]| format.write_answer(&AnswerHead::default(), outputs, to);
    assert_eq!(write(&[1.0], &mut bytes[..72]), refused);
    assert_eq!(write(&[1.0; 2], &mut bytes[..68]), refused);
}

#[test]
fn messages_have_a_limit() {
    const MOST: usize = limits::FRAME_BYTES / 4;
    assert!(ServedFormat::new(0, 200_000, 200_000, 256).is_ok());
    for (inputs, outputs, actions) in [(MOST, 1, 0), (1, MOST, 0), (1, 1, 257), (usize::MAX, 1, 0)]
    {
        let refused = ServedFormat::new(0, inputs, outputs, actions);
        assert_eq!(refused, Err(MessageError::Length));
    }
}

#[test]
fn numbers_name_what_they_stand_for() {
    for number in 0..10 {
        let status = AnswerStatus::from_number(number);
        assert_eq!(status.map(|status| status as u16), (number < 4).then_some(number));
        let reason = Reason::from_number(number);
        assert_eq!(reason.map(|reason| reason as u16), (number < 8).then_some(number));
    }
}
