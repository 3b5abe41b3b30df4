//! A frame lies in memory that its sender can still write. Whatever it writes there between a runner's acceptance and
//! its decisions: nothing panics, and no answer names an agent, an action or a subtask that does not exist.

use sortie_core::include_plan;
use sortie_core::link::{
    ActionTx, AllocRx, Bell, Clock, Frame, FrameBlock, FrameRx, LinkError, StatTx, Wake,
};
use sortie_core::plan::Plan;
use sortie_core::roles::{Identity, RunnerOptions, RunnerRole};
use sortie_core::wire::{
    ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameLayout, FrameMut, Role, StatMsg,
};
use sortie_core::{EntityMask, NO_ACTION, PlanPolicy, Shape, UNASSIGNED};
use zerocopy::IntoBytes;

const AGENT: &[u8] = include_plan!("../../../../tests/golden/plans/agent-2.0.plan");
const SHAPE: Shape = Shape { agents: 3, entities: 5, tasks: 2, actions: 4, features: 6 };
const TICK: u64 = 7 << 32 | 1;

/// Shows a frame to be accepted, and another one to be worked on.
struct Rewritten {
    shown: (FrameHeader, Vec<FrameBlock>),
    kept: (FrameHeader, Vec<FrameBlock>),
    allocation: AllocMsg,
    answers: Vec<ActionMsg>,
}

impl FrameRx for Rewritten {
    fn receive_frames(
        &mut self,
        accept: &mut dyn FnMut(Frame<'_>) -> bool,
    ) -> Result<bool, LinkError> {
        let (header, payload) = &self.shown;
        Ok(accept(Frame { header, payload: payload.as_bytes() }))
    }

    fn frame(&self) -> Option<Frame<'_>> {
        let (header, payload) = &self.kept;
        Some(Frame { header, payload: payload.as_bytes() })
    }
}

impl AllocRx for Rewritten {
    fn receive_allocations(&mut self, take: &mut dyn FnMut(&AllocMsg)) -> Result<(), LinkError> {
        take(&self.allocation);
        Ok(())
    }
}

impl ActionTx for Rewritten {
    fn send_action(&mut self, action: &ActionMsg) -> Result<(), LinkError> {
        self.answers.push(*action);
        Ok(())
    }
}

impl StatTx for Rewritten {
    fn send_status(&mut self, _: &StatMsg) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Bell for Rewritten {
    fn token(&self) -> u32 {
        0
    }

    fn wait_until(&mut self, _: u32, _: u64) -> Wake {
        Wake::Timeout
    }

    fn ring(&mut self, _: Role) -> Result<(), LinkError> {
        Ok(())
    }
}

impl Clock for Rewritten {
    fn now_ns(&self) -> u64 {
        2_000
    }
}

/// A runner of some agents, what it is shown, and the plan that it decides by.
struct Scene {
    format: FrameFormat,
    agents: u64,
    link: Rewritten,
    plan: Plan<'static>,
    arena: Vec<FrameBlock>,
}

impl Scene {
    fn new(layout: FrameLayout, agents: u64) -> Self {
        let format = FrameFormat { schema: 5, layout };
        let header = FrameHeader {
            magic: FrameHeader::MAGIC,
            abi: 3,
            kind: layout.kind() as u16,
            schema: format.schema,
            seq: 1,
            tick: TICK,
            t_ns: 1_000,
            deadline_ns: 9_000,
            len: layout.payload_bytes() as u32,
            flags: 0,
            generation: 0,
            world_term: 7,
            episode: 0,
        };
        let mut payload = vec![FrameBlock::zeroed(); layout.payload_bytes() / 64];
        let mut frame = FrameMut::new(payload.as_mut_bytes(), layout).unwrap();
        fill(&mut frame, agents);
        let allocation = AllocMsg {
            schema: format.schema,
            seq: 1,
            tick: TICK,
            t_ns: 0,
            valid_until: TICK,
            term: 1,
            epoch: 1,
            model: 0,
            decide_ns: 0,
            n_agents: SHAPE.agents as u16,
            n_tasks: SHAPE.tasks as u8,
            abi: 3,
            flags: 0,
            task: [1; 64],
        };
        let shown = (header, payload);
        let link = Rewritten { kept: shown.clone(), shown, allocation, answers: Vec::new() };
        let plan = Plan::load(AGENT).unwrap();
        let arena = vec![FrameBlock::zeroed(); plan.batch_arena_bytes(3).div_ceil(64)];
        Self { format, agents, link, plan, arena }
    }

    /// Flips some bits of some bytes, counted from the header's first, and lets a new runner answer.
    fn answers(&mut self, changes: &[(usize, u8)]) -> &[ActionMsg] {
        let Rewritten { shown, kept, answers, .. } = &mut self.link;
        kept.clone_from(shown);
        answers.clear();
        let mut bytes: Vec<&mut u8> =
            kept.0.as_mut_bytes().iter_mut().chain(kept.1.as_mut_bytes()).collect();
        changes.iter().for_each(|(byte, bits)| *bytes[*byte] ^= bits);
        let mut policy = PlanPolicy::new(self.plan.clone(), self.arena.as_mut_bytes()).unwrap();
        let mut role = RunnerRole::new(RunnerOptions {
            format: self.format,
            identity: Identity::new(8, "runner"),
            agents: self.agents,
            subtasks: true,
            decision_interval: 4,
            period_ns: 1_000,
            safe_action: Some(1),
        });
        role.poll(&mut self.link, &mut policy).unwrap();
        for answer in &self.link.answers {
            let is_action =
                answer.action == NO_ACTION || usize::from(answer.action) < SHAPE.actions;
            let is_task = answer.task == UNASSIGNED || usize::from(answer.task) < SHAPE.tasks;
            let is_own = answer.agent < 64 && self.agents >> answer.agent & 1 == 1;
            assert!(is_action && is_task && is_own, "{changes:?}: {answer:?}");
        }
        &self.link.answers
    }

    fn bytes(&self) -> usize {
        size_of::<FrameHeader>() + self.format.layout.payload_bytes()
    }
}

/// Everybody is there, sees everybody, can do everything, and has just done something.
fn fill(frame: &mut FrameMut<'_>, agents: u64) {
    let everybody = EntityMask::from_words(&[0b11111]);
    frame.set_present(&everybody);
    frame.set_open_tasks(0b11);
    // A private frame has a place for its owner alone.
    for place in 0..agents.count_ones() as usize {
        frame.set_observable(place, &everybody);
        frame.available_mut(place).fill(1);
    }
    (0..SHAPE.agents).for_each(|agent| frame.set_last_action(agent, 2));
    let numbers = (0..).map(|number| (number % 7) as f32 - 3.0);
    frame.rows_mut().iter_mut().zip(numbers).for_each(|(to, number)| *to = number);
    frame.set_progress(0, TICK, 0);
}

fn scenes() -> [Scene; 2] {
    [
        Scene::new(FrameLayout::new(SHAPE).unwrap(), 0b111),
        Scene::new(FrameLayout::private(SHAPE, 1).unwrap(), 0b10),
    ]
}

fn decided(answer: &ActionMsg) -> (u16, u32) {
    (answer.action, answer.q.to_bits())
}

#[test]
fn every_byte_may_change_between_acceptance_and_decision() {
    for mut scene in scenes() {
        let sound = scene.answers(&[]).to_vec();
        assert_eq!(sound.len(), scene.agents.count_ones() as usize);
        assert!(sound.iter().all(|answer| answer.flags == 0), "{sound:?}");
        let mut differ = 0;
        for byte in 0..scene.bytes() {
            for bits in [0x01, 0x80, 0xFF] {
                let answers = scene.answers(&[(byte, bits)]).iter();
                differ += usize::from(!answers.map(decided).eq(sound.iter().map(decided)));
            }
        }
        assert!(differ > 100, "what is worked on is the rewritten frame: {differ}");
    }
}

#[test]
fn many_bytes_may_change_at_once() {
    let mut state = 1_u64;
    let mut below = |bound: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        (state >> 33) as usize % bound
    };
    for mut scene in scenes() {
        // The magic and what else a second look finds stay as they are, or nothing is worked on.
        let (start, end) = (size_of::<FrameHeader>(), scene.bytes());
        for _ in 0..5_000 {
            let changes: Vec<(usize, u8)> = (0..1 + below(60))
                .map(|_| (start + below(end - start), below(256) as u8))
                .collect();
            scene.answers(&changes);
        }
    }
}
