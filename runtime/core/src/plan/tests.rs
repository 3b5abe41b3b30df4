//! Laws of plans of random shapes and weights: every build of the kernels gives the same bits, and a team the bits
//! of its members alone.

mod cells;
mod drafts;
mod in_team;
mod int8;
mod look_up;
mod pictures;
mod policy;
mod refusals;
mod steps;

use std::vec;
use std::vec::Vec;

use super::{
    ALIGNMENT, AlignedBytes, HEADER_BYTES, Header, Network, Plan, PlanError, Profile, Program,
    ProgramDraft, Proof, checksums,
};
use crate::kernels::build::Build;
use crate::kernels::mark::MARKED;
use crate::kernels::product::padded;
use crate::ops::{AttendOwn, Dense, EmbedEntities, Flag, Linear, MaskedArgmax, Op, Place};
use crate::policy::NO_ACTION;
use crate::{DecideError, Decision, EntityMask, Observation};

const PROFILES: [Profile; 3] = [Profile::Exact, Profile::Int8, Profile::Fused];

/// The profiles that the widest build runs: without the feature `std` it is the portable one, which does not fuse.
fn profiles() -> &'static [Profile] {
    if Build::widest().fuses() { &PROFILES } else { &[Profile::Exact, Profile::Int8] }
}

/// Pseudo-random numbers of a linear congruential generator.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        (self.0 >> 33) as usize % bound
    }

    fn within(&mut self, bound: f32) -> f32 {
        (self.below(1 << 20) as f32 / (1 << 19) as f32 - 1.0) * bound
    }
}

/// Sizes of a random network.
#[derive(Clone, Copy, Debug)]
struct Sizes {
    n_max: usize,
    features: usize,
    actions: usize,
    last_action: bool,
    width: usize,
    heads: usize,
    head: usize,
    base: usize,
    /// Inputs of a skip past the attention: the width, or none.
    skip: usize,
}

impl Sizes {
    fn random(random: &mut Random) -> Self {
        let width = 8 * (1 + random.below(32));
        Self {
            n_max: 1 + random.below(32),
            features: 1 + random.below(80),
            actions: 1 + random.below(20),
            last_action: random.below(2) == 0,
            width,
            heads: 1 + random.below(8),
            head: 1 + random.below(32),
            base: 8 * (1 + random.below(12)),
            skip: width * random.below(2),
        }
    }
}

/// Lays out weights and places one behind the other.
struct Builder<'r> {
    random: &'r mut Random,
    weights: Vec<f32>,
    floats: usize,
}

impl Builder<'_> {
    fn place(&mut self, len: usize) -> Place {
        let place = Place { offset: self.floats as u32, len: len as u32 };
        self.floats = (self.floats + len).next_multiple_of(16);
        place
    }

    fn numbers(&mut self, count: usize, bound: f32) -> u32 {
        self.weights.resize(self.weights.len().next_multiple_of(16), 0.0);
        let start = self.weights.len() as u32;
        self.weights.extend((0..count).map(|_| self.random.within(bound)));
        start
    }

    fn layer(&mut self, inputs: usize, outputs: usize) -> Linear {
        let bound = 1.5 / (inputs as f32).sqrt();
        let weights = self.numbers(inputs * padded(outputs), bound);
        let bias = self.numbers(padded(outputs), 0.5);
        Linear { inputs: inputs as u16, outputs: outputs as u16, weights, bias }
    }
}

/// A plan of a random network.
fn plan(sizes: Sizes, profile: Profile, random: &mut Random) -> AlignedBytes {
    if profile == Profile::Int8 {
        return int8::plan(sizes, random);
    }
    let Sizes { n_max, features, actions, width, heads, head, base, skip, .. } = sizes;
    let mut build = Builder { random, weights: Vec::new(), floats: 0 };
    let rows = build.place((n_max + 1) * width);
    let last_actions = if sizes.last_action { actions } else { 0 };
    let relu = Flag::from(build.random.below(2) == 0);
    let attended = heads * padded(head) + skip;
    let embed = EmbedEntities {
        layer: build.layer(features + last_actions, width),
        last_actions: last_actions as u32,
        relu: Flag::Yes,
        rows,
    };
    let bound = 1.5 / (width as f32).sqrt();
    let attend = AttendOwn {
        rows,
        width: width as u16,
        heads: heads as u16,
        query: build.layer(width, heads * head),
        keys: build.numbers(heads * head * width, bound),
        values: build.numbers(heads * width * padded(head), bound),
        output: build.layer(attended, width),
        relu,
        query_place: build.place(padded(heads * head)),
        absorbed: build.place(width),
        scores: build.place(n_max),
        mixed: build.place(width),
        attended: build.place(attended),
        to: build.place(width),
    };
    let (hidden, utilities) = (build.place(base), build.place(padded(actions)));
    let first = Dense {
        layer: build.layer(width, base),
        relu: Flag::Yes,
        sparse_input: relu,
        from: attend.to,
        to: hidden,
    };
    let last = Dense {
        layer: build.layer(base, actions),
        relu: Flag::No,
        sparse_input: Flag::Yes,
        from: hidden,
        to: utilities,
    };
    let from = Place { len: actions as u32, ..utilities };
    let ops = [
        Op::EmbedEntities(embed),
        Op::AttendOwn(attend),
        Op::Dense(first),
        Op::Dense(last),
        Op::MaskedArgmax(MaskedArgmax { from }),
    ];
    let inputs = (features + last_actions).max(width).max(base);
    let program = ProgramDraft {
        ops: ops.to_vec(),
        floats: build.floats as u32,
        nonzeros: inputs.div_ceil(MARKED) as u32,
    };
    assemble(sizes, profile, &program, &build.weights)
}

fn assemble(
    sizes: Sizes,
    profile: Profile,
    program: &ProgramDraft,
    weights: &[f32],
) -> AlignedBytes {
    let program_bytes = program.to_bytes();
    let program_bytes = program_bytes.as_slice();
    let program: Program<'_> = Program::read(program_bytes).unwrap();
    let weights: Vec<u8> = weights.iter().flat_map(|weight| weight.to_le_bytes()).collect();
    let offset = (HEADER_BYTES + program_bytes.len()).next_multiple_of(ALIGNMENT);
    let header = Header {
        layout: profile.layout(),
        arena_bytes: program.arena_bytes() as u32,
        arena_alignment: ALIGNMENT as u32,
        n_max: sizes.n_max as u32,
        features: sizes.features as u32,
        actions: sizes.actions as u32,
        hidden: 0,
        program_offset: HEADER_BYTES as u32,
        program_len: program_bytes.len() as u32,
        weights_offset: offset as u32,
        weights_len: weights.len() as u32,
        source: [0; 32],
        contract: 0,
        proof: Proof::NONE,
        action_mismatch: 0.0,
        profile,
        network: Network::Agent,
        t_max: 0,
        arena_bytes_per_agent: 4 * program.own_floats().unwrap_or(0),
        skip: program.skips(),
    };
    let mut bytes = header.to_bytes(checksums(&header, program_bytes, &weights)).to_vec();
    bytes.extend_from_slice(program_bytes);
    bytes.resize(offset, 0);
    bytes.extend(weights);
    AlignedBytes::copy_of(&bytes)
}

/// The same plan with another header, and the checksums for it.
fn with_header(bytes: &[u8], change: impl FnOnce(&mut Header)) -> AlignedBytes {
    let (mut header, _) = Header::read(bytes).unwrap();
    change(&mut header);
    let program = &bytes[HEADER_BYTES..][..header.program_len as usize];
    let weights = &bytes[header.weights_offset as usize..][..header.weights_len as usize];
    let checksums = checksums(&header, program, weights);
    let mut changed = bytes.to_vec();
    changed[..HEADER_BYTES].copy_from_slice(&header.to_bytes(checksums));
    AlignedBytes::copy_of(&changed)
}

/// What the agents of one process see: one frame, and for every agent what it looks at.
struct Frame {
    sizes: Sizes,
    rows: Vec<f32>,
    last_actions: Vec<u16>,
    views: Vec<(EntityMask, usize, Vec<u16>)>,
}

impl Frame {
    /// Frames of more entities than a plan takes, whose agents see any of them or none.
    fn random(sizes: Sizes, agents: usize, random: &mut Random) -> Self {
        let entities = 1 + random.below(sizes.n_max + 8);
        let zeros = 1 + random.below(8);
        let mut number = || if random.below(zeros) == 0 { random.within(2.0) } else { 0.0 };
        let rows = (0..entities * sizes.features).map(|_| number()).collect();
        let action = |random: &mut Random| match random.below(sizes.actions + 1) {
            0 => NO_ACTION,
            action => action as u16 - 1,
        };
        let last_actions = (0..random.below(entities + 1)).map(|_| action(random)).collect();
        let view = |random: &mut Random| {
            let mut visible = EntityMask::EMPTY;
            let density = random.below(4);
            for entity in (0..entities).filter(|_| random.below(3) < density) {
                visible.insert(entity);
            }
            let available = (0..sizes.actions).map(|_| random.below(3) as u16).collect();
            (visible, random.below(entities), available)
        };
        let views = (0..agents).map(|_| view(random)).collect();
        Self { sizes, rows, last_actions, views }
    }

    /// Things go wrong: numbers that are none, actions and agents that do not exist.
    fn spoil(&mut self, random: &mut Random) {
        let entities = self.rows.len() / self.sizes.features;
        match random.below(4) {
            0 => self.rows[random.below(entities) * self.sizes.features] = f32::NAN,
            1 => self.last_actions.resize(1 + random.below(entities), 500),
            2 => self.views.iter_mut().take(1).for_each(|view| view.1 = entities + 3),
            _ => self.views.iter_mut().skip(1).take(1).for_each(|view| view.1 = usize::MAX),
        }
    }

    fn observations(&self) -> Vec<Observation<'_>> {
        let mut observations = Vec::new();
        for (visible, self_index, available) in &self.views {
            observations.push(Observation {
                rows: &self.rows,
                stride: self.sizes.features,
                last_actions: &self.last_actions,
                visible: *visible,
                self_index: *self_index,
                available,
            });
        }
        observations
    }
}

type Answer = Result<Vec<u32>, DecideError>;

fn bits(utilities: &[f32]) -> Vec<u32> {
    utilities.iter().map(|utility| utility.to_bits()).collect()
}

/// Every agent's answer alone, in an arena full of junk.
fn alone(plan: &Plan<'_>, observations: &[Observation<'_>]) -> Vec<Answer> {
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut utilities = vec![0.0; plan.actions()];
    let ask = |observation| {
        arena.as_mut_slice().fill(0xff);
        let answer = plan.utilities(arena.as_mut_slice(), observation, None, &mut utilities);
        answer.map(|()| bits(&utilities))
    };
    observations.iter().map(ask).collect()
}

/// The answers of all agents in one call, in an arena with room for `room` of them.
fn together(plan: &Plan<'_>, observations: &[Observation<'_>], room: usize) -> Vec<Answer> {
    let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(room));
    arena.as_mut_slice().fill(0xff);
    let mut utilities = vec![0.0; observations.len() * plan.actions()];
    let mut results = vec![Err(DecideError::BadLength); observations.len()];
    plan.utilities_batch(arena.as_mut_slice(), observations, &mut utilities, &mut results);
    let rows = utilities.chunks(plan.actions());
    results.iter().zip(rows).map(|(result, row)| result.map(|()| bits(row))).collect()
}

#[test]
fn every_build_gives_the_same_bits() {
    let mut random = Random(1);
    for _ in 0..40 {
        let sizes = Sizes::random(&mut random);
        builds_agree(sizes, &mut random);
        // Of these a build may attend with several heads at once.
        let (width, heads) = (64 * (1 + random.below(2)), 4 * (1 + random.below(2)));
        let skip = width * random.below(2);
        builds_agree(Sizes { width, heads, skip, ..sizes }, &mut random);
    }
}

fn builds_agree(sizes: Sizes, random: &mut Random) {
    for &profile in profiles() {
        let bytes = plan(sizes, profile, random);
        let plan = Plan::load(bytes.as_slice()).unwrap();
        let mut frame = Frame::random(sizes, 5, random);
        if random.below(4) == 0 {
            frame.spoil(random);
        }
        let observations = frame.observations();
        let want = alone(&plan.clone().on(Build::PORTABLE), &observations);
        for build in Build::all() {
            let plan = plan.clone().on(build);
            assert_eq!(alone(&plan, &observations), want, "{build:?} {profile:?} {sizes:?}");
            let got = together(&plan, &observations, 5);
            assert_eq!(got, want, "team, {build:?} {profile:?} {sizes:?}");
        }
    }
}

#[test]
fn a_team_gets_the_bits_of_its_members_alone() {
    let mut random = Random(2);
    for round in 0..120 {
        let sizes = Sizes::random(&mut random);
        let bytes = plan(sizes, profiles()[round % profiles().len()], &mut random);
        let plan = Plan::load(bytes.as_slice()).unwrap();
        let agents = random.below(20);
        let mut frame = Frame::random(sizes, agents, &mut random);
        if round % 3 == 0 {
            frame.spoil(&mut random);
        }
        let observations = frame.observations();
        let want = alone(&plan, &observations);
        for room in [1, 2, 1 + random.below(20), 64] {
            assert_eq!(together(&plan, &observations, room), want, "room {room}, {sizes:?}");
        }
    }
}

#[test]
fn a_team_decides_as_its_members_alone() {
    let mut random = Random(3);
    for round in 0..60 {
        let sizes = Sizes::random(&mut random);
        let bytes = plan(sizes, PROFILES[round % 2], &mut random);
        let plan = Plan::load(bytes.as_slice()).unwrap();
        let frames = [
            Frame::random(sizes, 4, &mut random),
            Frame::random(sizes, 3 + round % 5, &mut random),
        ];
        let mut observations: Vec<Observation<'_>> =
            frames.iter().flat_map(Frame::observations).collect();
        observations[1].available = &[];
        let none = vec![0; sizes.actions];
        observations[2].available = &none;
        let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(9));
        let arena = arena.as_mut_slice();
        let ask = |observation| plan.decide(arena, observation, None);
        let want: Vec<Result<Decision, DecideError>> = observations.iter().map(ask).collect();
        let mut got = vec![Err(DecideError::NonFinite); observations.len()];
        let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(9));
        plan.decide_batch(arena.as_mut_slice(), &observations, None, &mut got);
        assert_eq!(got, want, "{sizes:?}");
    }
}

#[test]
fn a_team_never_reads_what_no_member_sees() {
    let mut random = Random(4);
    for round in 0..60 {
        let sizes = Sizes::random(&mut random);
        let bytes = plan(sizes, PROFILES[round % 2], &mut random);
        let plan = Plan::load(bytes.as_slice()).unwrap();
        let mut frame = Frame::random(sizes, 6, &mut random);
        let want = together(&plan, &frame.observations(), 6);
        let mut seen = EntityMask::EMPTY;
        for (visible, own, _) in &frame.views {
            seen = seen.or(visible);
            seen.insert(*own);
        }
        for (entity, row) in frame.rows.chunks_mut(sizes.features).enumerate() {
            if !seen.contains(entity) {
                row.fill(f32::NAN);
            }
        }
        assert_eq!(together(&plan, &frame.observations(), 6), want);
    }
}

#[test]
fn profiles_differ_in_rounding_only() {
    let mut random = Random(5);
    if !Build::widest().fuses() {
        let bytes = plan(Sizes::random(&mut random), Profile::Fused, &mut random);
        let refused = Plan::load(bytes.as_slice()).map(|_| ());
        assert_eq!(refused, Err(PlanError::WrongProfile { got: Profile::Fused.id() }));
        return;
    }
    let mut differ = 0;
    for seed in 0..30 {
        let sizes = Sizes::random(&mut random);
        let answers = [Profile::Exact, Profile::Fused].map(|profile| {
            let bytes = plan(sizes, profile, &mut Random(seed));
            let frame = Frame::random(sizes, 4, &mut Random(seed));
            alone(&Plan::load(bytes.as_slice()).unwrap(), &frame.observations())
        });
        let [exact, fused] = &answers;
        differ += usize::from(exact != fused);
        for (exact, fused) in exact.iter().zip(fused) {
            match (exact, fused) {
                (Ok(exact), Ok(fused)) => {
                    for (exact, fused) in exact.iter().zip(fused) {
                        let (exact, fused) = (f32::from_bits(*exact), f32::from_bits(*fused));
                        let difference = (exact - fused).abs();
                        assert!(difference < 1e-5 * (1.0 + exact.abs()), "{exact} {fused}");
                    }
                }
                _ => assert_eq!(exact, fused),
            }
        }
    }
    assert!(differ > 20, "{differ} of 30 plans differ");
}

#[test]
fn the_arena_of_a_team_is_what_the_header_says() {
    let mut random = Random(6);
    let sizes = Sizes::random(&mut random);
    let bytes = plan(sizes, Profile::Exact, &mut random);
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let per_agent = plan.header().arena_bytes_per_agent as usize;
    assert!(per_agent > 0);
    assert_eq!(plan.batch_arena_bytes(1), plan.arena_bytes());
    assert_eq!(plan.batch_arena_bytes(5), plan.arena_bytes() + 4 * per_agent);
}

#[test]
fn the_own_row_reaches_the_answer_of_an_agent_that_sees_nothing() {
    let mut random = Random(7);
    for &profile in profiles() {
        let sizes = Sizes { n_max: 3, features: 6, width: 16, ..Sizes::random(&mut random) };
        for skip in [0, 16] {
            let bytes = plan(Sizes { skip, ..sizes }, profile, &mut Random(1));
            let plan = Plan::load(bytes.as_slice()).unwrap();
            let frame = Frame::random(sizes, 3, &mut Random(2));
            let mut observations = frame.observations();
            observations.iter_mut().for_each(|one| one.visible = EntityMask::EMPTY);
            let last = observations.len() - 1;
            for (own, observation) in observations.iter_mut().enumerate() {
                observation.self_index = own;
            }
            let answers = alone(&plan, &observations);
            assert!(answers.iter().all(Result::is_ok), "{profile:?} {skip}");
            assert_eq!(answers[0] != answers[last], skip > 0, "{profile:?} {skip}");
            assert_eq!(together(&plan, &observations, 3), answers, "{profile:?} {skip}");
        }
    }
}

#[test]
fn a_skip_that_the_header_does_not_name_is_refused_and_one_that_the_program_lacks_as_well() {
    for skip in [0, 24] {
        let sizes = Sizes { width: 24, skip, ..Sizes::random(&mut Random(8)) };
        for &profile in profiles() {
            let mut wrong = plan(sizes, profile, &mut Random(1)).as_slice().to_vec();
            let (mut header, _) = Header::read(&wrong).unwrap();
            assert_eq!(header.skip, skip > 0);
            header.skip = !header.skip;
            let program = &wrong[HEADER_BYTES..][..header.program_len as usize];
            let weights = &wrong[header.weights_offset as usize..];
            let header = header.to_bytes(checksums(&header, program, weights));
            wrong[..HEADER_BYTES].copy_from_slice(&header);
            let refused = Plan::load(AlignedBytes::copy_of(&wrong).as_slice()).map(|_| ());
            assert_eq!(refused, Err(PlanError::ShapeMismatch { op: 5 }));
        }
    }
}
