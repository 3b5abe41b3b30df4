//! States as bytes.

use sortie_envs::StateError;
use sortie_envs::random::generator;

use super::{opened, saved};

#[test]
fn bytes_that_hold_no_state_are_refused_and_change_nothing() {
    let mut world = opened("task1-2", &[]);
    world.reset(0, &mut generator(1));
    let good = saved(&*world);
    assert_eq!(good.len(), world.spec().state_bytes);
    let with = |at: usize, bytes: &[u8]| {
        let mut state = good.clone();
        state[at..at + bytes.len()].copy_from_slice(bytes);
        state
    };
    let length = |found| StateError::Length { found, wanted: good.len() };
    let impossible = |flaw: &str| StateError::Impossible(flaw.into());
    let pit = "pit 0 opens with an impossible probability or too late";
    for (state, want) in [
        (Vec::new(), length(0)),
        ([&*good, &[0]].concat(), length(good.len() + 1)),
        (with(0, &[2]), StateError::Version { found: 2, wanted: 1 }),
        (with(1, &501_u32.to_le_bytes()), impossible("it is 501 steps long")),
        (with(5, &f64::NAN.to_le_bytes()), impossible("its return is no number")),
        (with(13, &[2]), impossible("2 tiers are finished")),
        (with(16, &3_u16.to_le_bytes()), impossible("agent 1 is in cell 3")),
        (with(14, &400_u16.to_le_bytes()), impossible("agent 0 is in cell 400")),
        (with(18, &[4]), impossible("agent 0 found a treasure that there is not")),
        (with(20, &1.5_f64.to_le_bytes()), impossible(pit)),
        (with(28, &[1]), impossible(pit)),
    ] {
        assert_eq!(world.load(0, &state), Err(want));
        assert_eq!(saved(&*world), good);
    }
}
