//! States as bytes: saved, loaded, viewed, and refused where they are none.

use sortie_envs::group_matching::{GroupMatching, Parameters, sizes, state_bytes};
use sortie_envs::random::generator;
use sortie_envs::{Environment, StateError};

use super::{for_random_states, ring};

#[test]
fn a_loaded_state_goes_on_as_the_saved_one_does() {
    for_random_states(5, |world, label| {
        let parameters = *world.parameters();
        let mut bytes = Vec::new();
        world.save(0, &mut bytes);
        assert_eq!(bytes.len(), state_bytes(&parameters), "{label}");
        let mut other = GroupMatching::new(parameters, 1).unwrap();
        other.load(0, &bytes).unwrap();
        let sizes = sizes(world.spec());
        assert_eq!(sizes.cells, parameters.cells, "{label}");
        assert_eq!((other.ring(0), other.metrics(0)), (world.ring(0), world.metrics(0)), "{label}");
        let (mut one, mut random) = (world.clone(), [generator(1), generator(1)]);
        let actions = vec![2; parameters.agents];
        for _ in 0..3 {
            let outcome = one.step(0, &actions, &mut random[0]);
            assert_eq!(outcome, other.step(0, &actions, &mut random[1]), "{label}");
            assert_eq!((one.ring(0), one.metrics(0)), (other.ring(0), other.metrics(0)));
        }
    });
}

#[test]
fn bytes_that_hold_no_state_are_refused_and_change_nothing() {
    let mut world = ring("5x6x2");
    world.reset(0, &mut generator(1));
    let mut good = Vec::new();
    world.save(0, &mut good);
    let with = |at: usize, bytes: &[u8]| {
        let mut state = good.clone();
        state[at..at + bytes.len()].copy_from_slice(bytes);
        state
    };
    let length = |found| StateError::Length { found, wanted: good.len() };
    let impossible = |flaw: &str| StateError::Impossible(flaw.into());
    for (state, want) in [
        (Vec::new(), length(0)),
        (good[..9].to_vec(), length(9)),
        ([&*good, &[0]].concat(), length(good.len() + 1)),
        (with(0, &[2]), StateError::Version { found: 2, wanted: 1 }),
        (with(1, &51_u32.to_le_bytes()), impossible("it is 51 steps long")),
        (with(5, &f64::NAN.to_le_bytes()), impossible("its return is no number")),
        (with(14, &[6]), impossible("agent 1 is in cell 6")),
        (with(18, &[0b100000, 0b11111]), impossible("group 0 has a member that is no agent")),
        (with(18, &[0b00011, 0b10110]), impossible("agent 3 has no group")),
    ] {
        assert_eq!(world.load(0, &state), Err(want));
        let mut after = Vec::new();
        world.save(0, &mut after);
        assert_eq!(after, good);
    }
    let mut other = GroupMatching::new(Parameters::default(), 1).unwrap();
    assert_eq!(other.load(0, &good), Err(StateError::Length { found: 20, wanted: 23 }));
}
