//! Loads plans, decides, allocates, reads messages: on the bare machine, and without any path to a panic.
//!
//! The panic handler calls a function that exists nowhere, so that this program links only if the optimiser
//! found that no panic can be reached. Everything comes from behind [`black_box`]: what is proved holds for any
//! bytes and any sizes, not only for these.
#![no_std]
#![no_main]

mod bare;
mod links;

use core::hint::black_box;

use sortie_core::allocate::{
    CostAllocator, CostMethod, CostModel, LastAllocation, PlanTeamValue, PointingAllocator,
    PointingRules, ProposalAllocator, SearchMemory, TaskRelation, TeamValueAllocator, exact,
};
use sortie_core::options::{
    Affordance, MILESTONES, Milestone, OptionPolicy, OptionRules, PictureShape, PlanNetworks,
    Pursuit,
};
use sortie_core::plan::{Aligned, Given, GuardState, Guards, Plan, Trip, arena_bytes};
use sortie_core::wire::{AllocMsg, FrameFormat, FrameHeader, FrameLayout, FrameMut, FrameView};
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, EntityMask, Guarded, NO_ACTION,
    Observation, PlanPolicy, Policy, Shape, include_plan,
};
use zerocopy::FromBytes;

const AGENT: &[u8] = include_plan!("../../../golden/plans/agent-2.0.plan");
const INT8: &[u8] = include_plan!("../../../golden/plans/agent-int8-2.2.plan");
const TEAM_VALUE: &[u8] = include_plan!("../../../golden/plans/team-value-2.0.plan");

const POLICY: &[u8] = include_plan!("../../../golden/plans/policy-2.0.plan");
const GUARDED: &[u8] = include_plan!("../../../golden/plans/guarded-2.3.plan");
const CONTROLLER: &[u8] = include_plan!("../../../../models/crafting-iron/agent-controller.plan");
const META: &[u8] = include_plan!("../../../../models/crafting-iron/agent-meta.plan");
const AFFORDANCE: &[u8] = include_plan!("../../../../models/crafting-iron/agent-affordance.plan");
const PROPOSALS: &[u8] = include_plan!("../../../golden/plans/proposals-2.0.plan");
const ENCODER: &[u8] = include_plan!("../../../golden/plans/pointing-encoder-2.3.plan");
const DECODER: &[u8] = include_plan!("../../../golden/plans/pointing-decoder-2.3.plan");

/// Whether all gave what it should.
fn everything() -> bool {
    #[cfg(feature = "control")]
    if black_box(AGENT)[black_box(0)] == 0 {
        return false;
    }
    let agent = [0x3d88_a551, 0x3d82_935b, 0xbd6d_17ed, 0x3e8a_10e5];
    let int8 = [0x3d87_888d, 0x3d82_5ab5, 0xbd6c_2308, 0x3e8a_1056];
    decide::<{ arena_bytes(AGENT) }>(AGENT, agent) == Some(true)
        && decide::<{ arena_bytes(INT8) }>(INT8, int8) == Some(true)
        && allocate() == Some(true)
        && propose() == Some(true)
        && point() == Some(true)
        && respond() == Some(true)
        && guard() == Some(true)
        && run_options() == Some(true)
        && read_messages() == Some(true)
        && links::over_a_line() == Some(true)
}

/// The first recorded decision of a golden plan.
fn decide<const ARENA: usize>(plan: &[u8], want: [u32; 4]) -> Option<bool> {
    let plan = Plan::load(black_box(plan)).ok()?;
    let mut arena = Aligned([0; ARENA]);
    let mut policy = PlanPolicy::new(plan, black_box(&mut arena.0)).ok()?;
    let mut state = 0_u64;
    let mut number = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        state >> 40
    };
    let mut rows = [0.0; 30];
    for value in &mut rows {
        let number = number();
        *value = if number % 3 == 0 { 0.0 } else { number as f32 / 8_388_608.0 - 1.0 };
    }
    let last_actions = [number() as u16 % 4, NO_ACTION];
    let observation = black_box(Observation {
        rows: &rows,
        stride: 6,
        last_actions: &last_actions,
        visible: EntityMask::from_words(&[number() % 32]),
        self_index: number() as usize % 5,
        available: &[1; 4],
    });
    let mut utilities = [0.0; 4];
    policy.utilities(&observation, black_box(&mut utilities)).ok()?;
    let decision = policy.decide(&observation).ok()?;
    policy.plan().warm();
    let entity = observation.self_index;
    let beyond = Err(DecideError::BeyondGuards { entity, feature: 0 });
    for (range, wanted) in [([-1.0, 1.0], Ok(decision)), ([2.0, 3.0], beyond)] {
        let mut decided = [Err(DecideError::BadLength)];
        let ranges = black_box([range; 6]);
        Guarded::new(&mut policy, &ranges).decide_batch(black_box(&[observation]), &mut decided);
        if decided != [wanted] {
            return None;
        }
    }
    Some(utilities.map(f32::to_bits) == want && decision.action == 3)
}

/// The same numbers everywhere.
struct Constant(f32);

impl TaskRelation for Constant {
    fn columns(&self) -> usize {
        3
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, _: usize, relation: &mut [f32]) {
        relation.fill(self.0);
    }
}

impl CostModel for Constant {
    fn costs(&mut self, _: &AllocationState<'_>, costs: &mut [f32]) -> Result<(), AllocateError> {
        costs.fill(self.0);
        Ok(())
    }
}

/// Every allocator places both agents.
fn allocate() -> Option<bool> {
    let plan = Plan::load(black_box(TEAM_VALUE)).ok()?;
    let mut arena = Aligned([0; arena_bytes(TEAM_VALUE)]);
    let mut memory = [0.0; 1024];
    let mut network = PlanTeamValue::new(plan, black_box(&mut arena.0), &mut memory).ok()?;
    let mut cells = [exact::Cell::default(); exact::cells(3, 2)];
    let (mut values, mut relation) = ([0.0; exact::cells(3, 2)], [0.0; 5 * 3]);
    let state = black_box(AllocationState {
        agents: 3,
        tasks: 2,
        rows: &[0.5; 30],
        stride: 6,
        present: EntityMask::from_words(&[0b11_101]),
        entity_task: &[0, 0, 0, 1, 2],
        open_tasks: 0b11,
        available: &[],
    });
    let mut all = true;
    for exact_agents in [8, 0] {
        let mut allocator = TeamValueAllocator {
            network: &mut network,
            relation: Constant(0.25),
            start: LastAllocation,
            team_max: black_box(2),
            exact_agents: black_box(exact_agents),
            memory: SearchMemory {
                cells: &mut cells,
                values: &mut values,
                relation: &mut relation,
            },
        };
        all &= places_both(&mut allocator, &state);
    }
    for method in [CostMethod::Greedy, CostMethod::Hungarian] {
        let (model, team_max) = (Constant(1.0), black_box(1));
        let mut costs = [0.0; 6];
        let costs = black_box(costs.as_mut_slice());
        all &= places_both(&mut CostAllocator { model, method, team_max, costs }, &state);
    }
    Some(all)
}

/// A policy of general steps writes its outputs, and chooses among them.
fn respond() -> Option<bool> {
    let plan = Plan::load(black_box(POLICY)).ok()?;
    let mut arena = Aligned([0; arena_bytes(POLICY)]);
    let (features, mask) = ([0.25; 70], [0.0; 7]);
    let inputs: [&[f32]; 2] = [&features, &mask];
    let inputs = black_box(inputs.as_slice());
    let mut output = [0.0; 6];
    let outputs = &mut [black_box(output.as_mut_slice())];
    plan.respond(black_box(&mut arena.0), inputs, black_box(&mut []), outputs).ok()?;
    let available = [0, 1, 0, 0, 0, 0];
    let given = Given { inputs, available: black_box(available.as_slice()) };
    let decision = plan.choose(&mut arena.0, &given, &mut []).ok()?;
    Some(decision.action == 1 && output.get(1) == Some(&decision.utility))
}

/// Guards let one input and one output through, and answer for others.
fn guard() -> Option<bool> {
    let guards = Guards::of_plan(black_box(GUARDED)).ok()??;
    guards.check_fits(black_box(1), black_box(1)).ok()?;
    let (mut room, mut output) = ([0.0], [0.25]);
    let mut state = GuardState::new(black_box(room.as_mut_slice()));
    let inputs = black_box([0.5]);
    guards.check_inputs(&state, black_box(inputs.as_slice()), black_box(Some(1))).ok()?;
    let outputs = black_box(output.as_mut_slice());
    guards.check_outputs(&mut state, outputs).ok()?;
    let beyond = black_box([f32::NAN]);
    let trip = guards.check_inputs(&state, black_box(beyond.as_slice()), None).err()?;
    guards.fall_back(&mut state, trip, outputs);
    Some(trip == Trip::InputRange { index: 0 } && *outputs.first()? == 0.0)
}

/// The best of some proposals places both agents.
fn propose() -> Option<bool> {
    let plan = Plan::load(black_box(PROPOSALS)).ok()?;
    let mut arena = Aligned([0; arena_bytes(PROPOSALS)]);
    let arena = black_box(&mut arena.0);
    let mut allocator = ProposalAllocator::new(plan, arena, black_box(8), black_box(1)).ok()?;
    let state = black_box(AllocationState {
        agents: 3,
        tasks: 2,
        rows: &[0.5; 35],
        stride: 7,
        present: EntityMask::from_words(&[0b11_101]),
        entity_task: &[0, 0, 0, 1, 2],
        open_tasks: 0b11,
        available: &[],
    });
    Some(places_both(&mut allocator, &state))
}

/// Both agents are pointed somewhere.
fn point() -> Option<bool> {
    let plans = [Plan::load(black_box(ENCODER)).ok()?, Plan::load(black_box(DECODER)).ok()?];
    let mut arena = Aligned([0; arena_bytes(ENCODER) + arena_bytes(DECODER)]);
    let mut memory = [0.0; 2700];
    let rules = black_box(PointingRules { exclusive: 0b01, first_action: 0 });
    let (arena, memory) = (black_box(&mut arena.0), black_box(&mut memory));
    let mut allocator = PointingAllocator::new(plans, rules, arena, memory).ok()?;
    let state = black_box(AllocationState {
        agents: 3,
        tasks: 2,
        rows: &[0.5; 70],
        stride: 14,
        present: EntityMask::from_words(&[0b11_101]),
        entity_task: &[0, 0, 0, 1, 2],
        open_tasks: 0b11,
        available: &[1; 6],
    });
    Some(places_both(&mut allocator, &state))
}

fn places_both(allocator: &mut impl Allocator, state: &AllocationState<'_>) -> bool {
    let mut allocation = [9; 3];
    let places = black_box(allocation.as_mut_slice());
    allocator.allocate(state, places).is_ok() && matches!(allocation, [0..=1, 0xFF, 0..=1])
}

/// The milestones of iron, by what is carried.
fn rules() -> Option<OptionRules> {
    let picture = PictureShape { channels: 9, size: 11, counts: 12, crop: 5, nearest: true };
    let signs =
        [(0, 1), (2, 4), (3, 4), (2, -4), (5, 1), (4, 1), (4, -4), (6, 1), (8, 1), (10, 1), (9, 1)];
    let affordance = Affordance::Learned;
    let milestones = signs.map(|(carried, change)| Milestone { carried, change, affordance });
    let mut rules = OptionRules::new(picture, 11, 51, black_box(&milestones))?;
    (rules.action_chance, rules.goal_chance, rules.seed) = (0.05, 0.05, 3);
    Some(rules)
}

/// An agent that runs options chooses what to go for, and goes for it.
fn run_options() -> Option<bool> {
    let plans = [CONTROLLER, META, AFFORDANCE].map(|plan| Plan::load(black_box(plan)).ok());
    let [controller, meta, affordance] = plans;
    let mut arena = Aligned([0; arena_bytes(CONTROLLER)]);
    let networks = PlanNetworks::new([controller?, meta?, affordance?], black_box(&mut arena.0));
    let (mut shown, mut memory, mut row) = ([0.0; 1386], [0.0; 78], [0.0; 1101]);
    let shown = black_box(shown.as_mut_slice());
    let mut policy = OptionPolicy::new(rules()?, networks.ok()?, shown)?;
    // A tree in front, three logs.
    *row.get_mut(4 * 99 + 5 * 9 + 2)? = 1.0;
    *row.get_mut(1089)? = 3.0;
    let seen = Observation {
        rows: black_box(&row),
        stride: black_box(1101),
        last_actions: &[],
        visible: EntityMask::first(1),
        self_index: black_box(0),
        available: black_box(&[1; 11]),
    };
    let memory = black_box(memory.as_mut_slice());
    let decision = policy.decide_with(&seen, memory).ok()?;
    let pursuit = Pursuit::of(memory)?;
    let mut likelihoods = [0.0; MILESTONES];
    let likelihoods = likelihoods.get_mut(..policy.rules().milestones().len())?;
    policy.likelihoods(&seen, likelihoods).ok()?;
    let mask = policy.rules().mask(likelihoods);
    let is_afforded = mask >> (pursuit.goal as u32 & 31) & 1 == 1;
    Some(pursuit.steps == 1 && is_afforded && decision.action < 11)
}

/// A frame that was written is read, and an allocation of another schema is not.
fn read_messages() -> Option<bool> {
    let shape = black_box(Shape { agents: 2, entities: 3, tasks: 2, actions: 3, features: 5 });
    let layout = FrameLayout::new(shape).ok()?;
    let mut payload = Aligned([0; 2048]);
    let payload = payload.0.get_mut(..layout.payload_bytes())?;
    let mut frame = FrameMut::new(payload, layout).ok()?;
    frame.set_present(&EntityMask::first(black_box(3)));
    frame.set_observable(black_box(1), &EntityMask::first(2));
    frame.set_last_action(black_box(0), 2);
    let mut header = Aligned([0; size_of::<FrameHeader>()]);
    let header = FrameHeader::mut_from_bytes(&mut header.0).ok()?;
    header.magic = FrameHeader::MAGIC;
    header.abi = sortie_core::wire::ABI;
    header.len = payload.len() as u32;
    let format = FrameFormat { layout, schema: 0 };
    let view = FrameView::new(black_box(header), black_box(payload), &format).ok()?;
    let agent = black_box(1);
    let seen =
        sortie_core::visible(view.observable(agent), view.present(), view.entity_task(), None);
    let message = Aligned([0; size_of::<AllocMsg>()]);
    let message = AllocMsg::ref_from_bytes(black_box(&message.0)).ok()?;
    let refused = message.check(1, shape).is_err() && message.task_of(agent).is_some();
    let is_private = is_cut_for_its_agent(&view, shape, agent)?;
    Some(seen.is_empty() && view.observable(agent).len() == 2 && refused && is_private)
}

/// An agent's private frame is cut out of a frame, read, and observed.
fn is_cut_for_its_agent(view: &FrameView<'_>, shape: Shape, agent: usize) -> Option<bool> {
    let layout = FrameLayout::private(shape, agent).ok()?;
    let mut payload = Aligned([0; 2048]);
    let payload = black_box(payload.0.get_mut(..layout.payload_bytes())?);
    let header = view.write_private(&layout, payload).ok()?;
    let format = FrameFormat { layout, schema: 0 };
    let own = FrameView::new(black_box(&header), black_box(payload), &format).ok()?;
    let observation = own.observation(agent, &own.observable(agent));
    Some(observation.visible.len() == 2 && observation.self_index == 0)
}
