//! Plans of every version that this build reads decide with the bits that they had; those of earlier ones are refused.

use sortie_core::allocate::ProposalAllocator;
use sortie_core::allocate::proposals::GumbelDraw;
use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{Aligned, Plan, PlanError, Proof, arena_bytes};
use sortie_core::{AllocationState, DecideError, EntityMask, NO_ACTION, Observation, include_plan};

const AGENT: &[u8] = include_plan!("../../../../tests/golden/plans/agent-2.0.plan");
const PROVED: &[u8] = include_plan!("../../../../tests/golden/plans/agent-2.3.plan");
const INT8: &[u8] = include_plan!("../../../../tests/golden/plans/agent-int8-2.2.plan");
const ODD_SIZES: &[u8] = include_plan!("../../../../tests/golden/plans/agent-odd-sizes-2.0.plan");
const SKIP: &[u8] = include_plan!("../../../../tests/golden/plans/agent-skip-2.0.plan");
const INT8_SKIP: &[u8] = include_plan!("../../../../tests/golden/plans/agent-skip-int8-2.2.plan");
const TEAM_VALUE: &[u8] = include_plan!("../../../../tests/golden/plans/team-value-2.0.plan");
const TEAM_VALUE_SKIP: &[u8] =
    include_plan!("../../../../tests/golden/plans/team-value-skip-2.0.plan");
const PROPOSALS: &[u8] = include_plan!("../../../../tests/golden/plans/proposals-2.0.plan");

const POLICY: &[u8] = include_plan!("../../../../tests/golden/plans/policy-2.0.plan");
const POLICY_IN_TEAM: &[u8] =
    include_plan!("../../../../tests/golden/plans/policy-in-team-2.1.plan");

/// Plans of every version of before, as their first compiler wrote them.
const FIRST_MAJOR: [(&[u8], u16); 4] = [
    (include_plan!("../../../../tests/golden/plans/agent-1.0.plan"), 0),
    (include_plan!("../../../../tests/golden/plans/agent-int8-1.1.plan"), 1),
    (include_plan!("../../../../tests/golden/plans/proposals-1.2.plan"), 2),
    (include_plan!("../../../../tests/golden/plans/agent-skip-1.3.plan"), 3),
];

/// The numbers of the recorded observations, see the folder's README.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        self.0 >> 40
    }

    fn feature(&mut self) -> f32 {
        match self.next() {
            number if number % 3 == 0 => 0.0,
            number => number as f32 / 8_388_608.0 - 1.0,
        }
    }
}

/// One line a case: what was seen, and the bits of the utilities.
fn decisions<const ARENA: usize>(bytes: &[u8]) -> String {
    let plan = Plan::load(bytes).expect("a plan of the golden files");
    let (header, mut arena) = (*plan.header(), Aligned([0xFF; ARENA]));
    let mut lines = String::new();
    for seed in 0..16 {
        let mut numbers = Numbers(seed);
        let (entities, features) = (header.n_max as usize, header.features as usize);
        let rows: Vec<f32> = (0..entities * features).map(|_| numbers.feature()).collect();
        let last_actions = [numbers.next() as u16 % header.actions as u16, NO_ACTION];
        let words = [numbers.next() % (1 << entities)];
        let available = vec![1; plan.actions()];
        let observation = Observation {
            rows: &rows,
            stride: features,
            last_actions: &last_actions,
            visible: EntityMask::from_words(&words),
            self_index: numbers.next() as usize % entities,
            available: &available,
        };
        let mut answers = [vec![0.0; plan.actions()], vec![0.0; plan.actions()]];
        for (plan, utilities) in
            [plan.clone(), plan.clone().on(Build::PORTABLE)].iter().zip(&mut answers)
        {
            let mut state = vec![0.5; plan.hidden()];
            let computed = plan.utilities(&mut arena.0, &observation, Some(&mut state), utilities);
            computed.expect("finite utilities");
        }
        let [widest, portable] = answers.map(|utilities| {
            utilities
                .iter()
                .map(|utility| format!(" {:08x}", utility.to_bits()))
                .collect::<String>()
        });
        assert_eq!(widest, portable, "seed {seed}");
        lines +=
            &format!("{seed} visible {:02x} self {}:{widest}\n", words[0], observation.self_index);
    }
    lines
}

#[test]
fn an_agent_decides_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/agent-2.0.txt");
    assert_eq!(decisions::<{ arena_bytes(AGENT) }>(AGENT), want);
    assert_eq!(decisions::<{ arena_bytes(PROVED) }>(PROVED), want);
}

#[test]
fn plans_say_how_far_they_are_from_their_network_by_the_measure_of_their_version() {
    let proof = |bytes| Plan::load(bytes).expect("a golden plan").header().proof;
    let Proof::Distance { max_distance, inputs } = proof(PROVED) else { panic!("another measure") };
    assert!(max_distance > 0.1 && max_distance < 6.0 && inputs == 256, "{max_distance}, {inputs}");
    for before in [AGENT, POLICY_IN_TEAM, INT8] {
        let Proof::Error { max_rel_error } = proof(before) else { panic!("another measure") };
        assert!(max_rel_error > 0.0 && max_rel_error < 1e-3, "{max_rel_error}");
    }
}

#[test]
fn an_int8_agent_decides_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/agent-int8-2.2.txt");
    assert_eq!(decisions::<{ arena_bytes(INT8) }>(INT8), want);
}

#[test]
fn odd_sizes_decide_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/agent-odd-sizes-2.0.txt");
    assert_eq!(decisions::<{ arena_bytes(ODD_SIZES) }>(ODD_SIZES), want);
}

#[test]
fn agents_with_a_skip_decide_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/agent-skip-2.0.txt");
    assert_eq!(decisions::<{ arena_bytes(SKIP) }>(SKIP), want);
    let want = include_str!("../../../../tests/golden/plans/agent-skip-int8-2.2.txt");
    assert_eq!(decisions::<{ arena_bytes(INT8_SKIP) }>(INT8_SKIP), want);
}

#[test]
fn a_team_value_with_a_skip_is_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/team-value-skip-2.0.txt");
    assert_eq!(decisions::<{ arena_bytes(TEAM_VALUE_SKIP) }>(TEAM_VALUE_SKIP), want);
}

#[test]
fn a_policy_in_a_team_decides_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/policy-in-team-2.1.txt");
    assert_eq!(decisions::<{ arena_bytes(POLICY_IN_TEAM) }>(POLICY_IN_TEAM), want);
}

#[test]
fn a_team_value_is_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/team-value-2.0.txt");
    assert_eq!(decisions::<{ arena_bytes(TEAM_VALUE) }>(TEAM_VALUE), want);
}

/// One line a seed: every proposal with the bits of its value.
fn proposals() -> String {
    const COUNT: usize = 4;
    let plan = Plan::load(PROPOSALS).expect("a plan of the golden files");
    let mut arena = Aligned([0xFF; arena_bytes(PROPOSALS)]);
    let mut lines = String::new();
    for seed in 0..16 {
        let mut numbers = Numbers(seed);
        let rows: Vec<f32> = (0..5 * 7).map(|_| numbers.feature()).collect();
        let present = EntityMask::from_words(&[(numbers.next() % 32) | 1]);
        let state = AllocationState {
            agents: 3,
            tasks: 3,
            rows: &rows,
            stride: 7,
            present,
            entity_task: &[0, 1, 4, 1, 2],
            open_tasks: numbers.next() as u32 % 7 + 1,
            available: &[],
        };
        let mut answers = [String::new(), String::new()];
        for (build, answer) in [Build::widest(), Build::PORTABLE].into_iter().zip(&mut answers) {
            let plan = plan.clone().on(build);
            let allocator = ProposalAllocator::new(plan, &mut arena.0, COUNT, 0);
            let mut allocator = allocator.expect("an arena that fits");
            let proposed = allocator.propose(&state, &mut GumbelDraw { seed });
            let proposed = proposed.expect("finite values");
            for (proposal, value) in proposed.values().iter().enumerate() {
                let places: Vec<u8> = proposed.allocation(proposal).collect();
                *answer += &format!(" {places:?} {:08x}", value.to_bits());
            }
        }
        let [widest, portable] = answers;
        assert_eq!(widest, portable, "seed {seed}");
        lines += &format!("{seed}:{widest}\n");
    }
    lines
}

#[test]
fn proposals_are_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/proposals-2.0.txt");
    assert_eq!(proposals(), want, "got:\n{}", proposals());
}

/// One line a seed: the bits of a policy's only output.
fn responses() -> String {
    let plan = Plan::load(POLICY).expect("a plan of the golden files");
    let lengths: Vec<usize> = plan.program().inputs().map(|input| input.to.len as usize).collect();
    let [features, mask] = lengths[..] else { panic!("other inputs") };
    let mut lines = String::new();
    for seed in 0..16 {
        let mut numbers = Numbers(seed);
        let features: Vec<f32> = (0..features).map(|_| numbers.feature()).collect();
        let hidden = |index: usize| index > 0 && numbers.next().is_multiple_of(2);
        let mask: Vec<f32> = (0..mask).map(hidden).map(|set| f32::from(u8::from(set))).collect();
        let answers = [Build::widest(), Build::PORTABLE].map(|build| {
            let mut arena = Aligned([0xFF; arena_bytes(POLICY)]);
            let mut output = vec![0.0; plan.actions()];
            let inputs: [&[f32]; 2] = [&features, &mask];
            let plan = plan.clone().on(build);
            plan.respond(&mut arena.0, &inputs, &mut [], &mut [&mut output]).expect("numbers");
            output.iter().map(|number| format!(" {:08x}", number.to_bits())).collect::<String>()
        });
        assert_eq!(answers[0], answers[1], "seed {seed}");
        lines += &format!("{seed}:{}\n", answers[0]);
    }
    lines
}

#[test]
fn a_policy_responds_as_recorded() {
    let want = include_str!("../../../../tests/golden/plans/policy-2.0.txt");
    assert_eq!(responses(), want, "got:\n{}", responses());
}

#[test]
fn a_newer_major_version_is_refused_by_name() {
    let mut newer = Aligned([0; AGENT.len()]);
    newer.0.copy_from_slice(AGENT);
    newer.0[8] = 3;
    let error = Plan::load(&newer.0).map(drop).expect_err("a version that is not known");
    assert_eq!(error, PlanError::Version { major: 3, minor: 0 });
    assert!(error.to_string().contains("plan format 3.0"), "{error}");
}

#[test]
fn plans_of_the_first_major_version_are_refused_by_name() {
    for (plan, minor) in FIRST_MAJOR {
        let error = Plan::load(plan).map(drop).expect_err("a version of before");
        assert_eq!(error, PlanError::Version { major: 1, minor });
        let text = error.to_string();
        assert!(text.contains(&format!("1.{minor}")) && text.contains("compile"), "{text}");
    }
}

#[test]
fn int8_plans_that_attended_to_rows_of_f32_are_refused() {
    let before = include_plan!("../../../../tests/golden/plans/agent-int8-2.0.plan");
    let error = Plan::load(before).map(drop).expect_err("a layout of before");
    assert_eq!(error, PlanError::WrongLayout { got: 2 });
    assert!(error.to_string().contains("compile"), "{error}");
}

#[test]
fn rows_that_overlap_are_refused() {
    let plan = Plan::load(AGENT).expect("a golden plan");
    // With room for a team, so that several agents are worked on together.
    let mut arena = Aligned([0; 8 * arena_bytes(AGENT)]);
    let observation = Observation {
        rows: &[0.0; 30],
        stride: 5,
        last_actions: &[],
        visible: EntityMask::first(2),
        self_index: 0,
        available: &[1; 4],
    };
    assert_eq!(plan.decide(&mut arena.0, &observation, None), Err(DecideError::BadLength));
    let mut together = [Err(DecideError::Greedy); 2];
    plan.decide_batch(&mut arena.0, &[observation; 2], None, &mut together);
    assert_eq!(together, [Err(DecideError::BadLength); 2]);
}
