//! What loaders and callers of a plan may get wrong is refused by name.

use super::*;
use crate::entities::Entities;
use crate::limits;
use crate::plan::PlanError::{ArenaTooSmall, Misaligned, ShapeMismatch, WrongNetwork};

/// Operators of the plans of [`any`].
const OPS: usize = 5;

fn any() -> (Sizes, AlignedBytes) {
    let mut random = Random(6);
    let sizes = Sizes { n_max: 8, ..Sizes::random(&mut random) };
    (sizes, plan(sizes, Profile::Exact, &mut random))
}

/// What one agent sees of a few entities.
fn frame(sizes: Sizes) -> Frame {
    let mut random = Random(7);
    Frame {
        sizes,
        rows: (0..4 * sizes.features).map(|_| random.within(2.0)).collect(),
        last_actions: Vec::new(),
        views: vec![(EntityMask::first(4), 1, vec![1; sizes.actions])],
    }
}

type Change = fn(&mut Header, u32);

/// Loads a plan whose header says something else.
fn load_with(bytes: &[u8], change: impl FnOnce(&mut Header)) -> Result<(), PlanError> {
    Plan::load(with_header(bytes, change).as_slice()).map(drop)
}

#[test]
fn a_header_that_does_not_fit_its_program_is_refused() {
    let (_, bytes) = any();
    let bytes = bytes.as_slice();
    assert_eq!(load_with(bytes, |_| ()), Ok(()));
    let (entities, actions) = (limits::ENTITIES as u32 + 1, limits::ACTIONS as u32 + 1);
    let features = limits::FEATURES as u32 + 1;
    let changes: [(&str, Change, u32); 9] = [
        ("arena_alignment", |header, to| header.arena_alignment = to, 32),
        ("n_max", |header, to| header.n_max = to, 0),
        ("n_max", |header, to| header.n_max = to, entities),
        ("actions", |header, to| header.actions = to, 0),
        ("actions", |header, to| header.actions = to, actions),
        ("features", |header, to| header.features = to, 0),
        ("features", |header, to| header.features = to, features),
        ("arena_bytes", |header, to| header.arena_bytes += to, 64),
        ("arena_bytes_per_agent", |header, to| header.arena_bytes_per_agent ^= to, 8),
    ];
    for (field, change, to) in changes {
        let refused = load_with(bytes, |header| change(header, to));
        assert_eq!(refused, Err(ShapeMismatch { op: OPS }), "{field} {to}");
    }
    // The last operator with weights reaches behind them.
    let refused = load_with(bytes, |header| header.weights_len -= 64);
    assert_eq!(refused, Err(ShapeMismatch { op: 3 }));
}

#[test]
fn a_plan_or_an_arena_at_an_odd_place_is_refused() {
    let (_, bytes) = any();
    let moved = |by: usize| {
        let mut moved = AlignedBytes::zeroed(by + bytes.as_slice().len());
        moved.as_mut_slice()[by..].copy_from_slice(bytes.as_slice());
        Plan::load(&moved.as_slice()[by..]).map(drop)
    };
    assert_eq!(moved(4), Err(Misaligned { need: ALIGNMENT, got: 4 }));
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let need = plan.arena_bytes();
    let arena = AlignedBytes::zeroed(need + 24);
    let arena = arena.as_slice();
    assert_eq!(plan.check_arena(arena), Ok(()));
    assert_eq!(plan.check_arena(&arena[..need]), Ok(()));
    let got = need - 4;
    assert_eq!(plan.check_arena(&arena[..got]), Err(ArenaTooSmall { need, got }));
    let odd = Err(Misaligned { need: ALIGNMENT, got: 8 });
    assert_eq!(
        (plan.check_arena(&arena[24..]), plan.check_arena_alignment(&arena[24..])),
        (odd, odd)
    );
}

#[test]
fn a_plan_does_only_what_its_network_is_for() {
    let (sizes, bytes) = any();
    let agent = Plan::load(bytes.as_slice()).unwrap();
    let with = |network, hidden| {
        let header = Header { network, hidden, ..agent.header };
        Plan { header, ..agent.clone() }
    };
    let entities = with(Network::Entities, 0);
    assert_eq!(agent.check_network(Network::Agent), Ok(()));
    assert_eq!(entities.check_network(Network::Agent), Err(WrongNetwork));

    let mut arena = AlignedBytes::zeroed(agent.arena_bytes());
    let arena = arena.as_mut_slice();
    let frame = frame(sizes);
    let observation = &frame.observations()[0];
    assert_eq!(agent.sample(arena, observation, None, 0), Err(DecideError::Greedy));
    let remembers = with(Network::Agent, 3);
    let refused = remembers.decide(arena, observation, None);
    assert_eq!(refused, Err(DecideError::HiddenState { want: 3, got: 0 }));

    // The program has no output.
    let nobody = Entities {
        rows: &[],
        stride: sizes.features,
        present: EntityMask::EMPTY,
        agents: EntityMask::EMPTY,
        groups: &[],
    };
    let mut evaluate = |plan: &Plan<'_>, outputs: usize| {
        let mut places = [[0.0; 1]];
        let mut outputs: Vec<&mut [f32]> =
            places.iter_mut().take(outputs).map(|place| place.as_mut_slice()).collect();
        plan.evaluate(arena, &nobody, &mut outputs)
    };
    assert_eq!(evaluate(&agent, 0), Err(DecideError::BadLength));
    assert_eq!(evaluate(&entities, 1), Err(DecideError::BadLength));
    assert_eq!(evaluate(&entities, 0), Ok(()), "without entities no row is embedded");
}

#[test]
fn rows_are_embedded_wherever_an_entity_exists() {
    let (sizes, bytes) = any();
    let agent = Plan::load(bytes.as_slice()).unwrap();
    let entities =
        Plan { header: Header { network: Network::Entities, ..agent.header }, ..agent.clone() };
    let mut frame = frame(sizes);
    let before = alone(&agent, &frame.observations());
    assert_eq!(alone(&entities, &frame.observations()), before);
    frame.rows[sizes.features] += 1.0;
    assert_ne!(alone(&agent, &frame.observations()), before);
}

#[test]
fn a_plan_runs_on_the_build_that_it_is_put_on() {
    let (_, bytes) = any();
    let plan = Plan::load(bytes.as_slice()).unwrap();
    for build in Build::all() {
        assert_eq!(plan.clone().on(build).arithmetic().build(), build);
    }
}
