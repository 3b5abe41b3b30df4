//! Messages of any bytes, and frames with any damage: refused, or read without a panic.
#![no_main]

mod input;

use input::Input;
use libfuzzer_sys::fuzz_target;
use sortie_core::plan::AlignedBytes;
use sortie_core::wire::{
    ABI, ActionMsg, AllocMsg, AnswerHead, ControlRep, ControlReq, FrameFormat, FrameHeader,
    FrameLayout, FrameMut, FrameView, ObservationHead, ServedFormat, StatMsg,
};
use sortie_core::{EntityMask, Shape, visible};
use zerocopy::{FromBytes, IntoBytes};

const SCHEMA: u64 = 0;

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    let shape = Shape {
        agents: input.up_to(66),
        entities: input.up_to(130),
        tasks: input.up_to(33),
        actions: input.up_to(9),
        features: input.up_to(9),
    };
    messages(&mut input, shape);
    if let Ok(layout) = FrameLayout::new(shape) {
        frame(&mut input, layout);
    }
    served(&mut input, shape);
});

fn messages(input: &mut Input<'_>, shape: Shape) {
    if let Ok(message) = AllocMsg::read_from_bytes(input.bytes(size_of::<AllocMsg>())) {
        let mut message: AllocMsg = message;
        let checked = message.check(SCHEMA, shape);
        message.abi = ABI as u8;
        if checked.is_ok() {
            let tasks = (0..shape.agents).filter_map(|agent| message.task_of(agent));
            assert!(tasks.into_iter().all(|task| usize::from(task) < shape.tasks));
        }
        let _ = (message.order(), message.task_of(usize::MAX), message.check(SCHEMA, shape));
    }
    if let Ok(message) = ActionMsg::read_from_bytes(input.bytes(size_of::<ActionMsg>())) {
        let _ = (message.fits(SCHEMA), message.has(ActionMsg::BYE));
    }
    if let Ok(message) = StatMsg::read_from_bytes(input.bytes(size_of::<StatMsg>())) {
        let _ = (message.fits(SCHEMA), message.has(StatMsg::BYE));
    }
    if let Ok(message) = ControlReq::read_from_bytes(input.bytes(size_of::<ControlReq>())) {
        assert!(message.text().len() <= message.text.len());
    }
    if let Ok(message) = ControlRep::read_from_bytes(input.bytes(size_of::<ControlRep>())) {
        assert!(message.text().len() <= message.text.len());
    }
}

/// What a robot and the server of its policy say to each other, cut anywhere and of any bytes behind the magic.
fn served(input: &mut Input<'_>, shape: Shape) {
    let Ok(format) = ServedFormat::new(SCHEMA, shape.entities, shape.agents, shape.actions) else {
        return;
    };
    for magic in [ObservationHead::MAGIC, AnswerHead::MAGIC] {
        let bytes =
            [format.observation_bytes(), format.answer_bytes(), input.up_to(800)][input.up_to(2)];
        let mut message = AlignedBytes::zeroed(bytes);
        let drawn = input.bytes(bytes.saturating_sub(16));
        let beginning = [magic.to_le_bytes(), u32::from(ABI).to_le_bytes(), [0; 4], [0; 4]];
        let beginning = beginning.iter().flatten().copied();
        for (to, from) in
            message.as_mut_slice().iter_mut().zip(beginning.chain(drawn.iter().copied()))
        {
            *to = from;
        }
        if let Ok(view) = format.read_observation(message.as_slice()) {
            assert_eq!(
                (view.inputs.len(), view.available.len()),
                (format.inputs(), format.actions())
            );
            assert_eq!(ObservationHead::of(message.as_slice()), Some(view.head));
        }
        if let Ok(view) = format.read_answer(message.as_slice()) {
            assert_eq!(view.outputs.len(), format.outputs());
        }
    }
}

/// A frame of the layout, some of its bytes changed.
fn frame(input: &mut Input<'_>, layout: FrameLayout) {
    let mut payload = AlignedBytes::zeroed(layout.payload_bytes());
    let Ok(mut frame) = FrameMut::new(payload.as_mut_slice(), layout) else { return };
    frame.set_present(&EntityMask::from_words(&[input.word(), input.word()]));
    frame.set_observable(input.up_to(66), &EntityMask::from_words(&[input.word()]));
    frame.set_entity_task(input.up_to(130), input.word() as u32);
    frame.set_open_tasks(input.word() as u32);
    frame.set_last_action(input.up_to(66), input.up_to(9) as u16);
    let mut header = AlignedBytes::zeroed(size_of::<FrameHeader>());
    if let Ok(header) = FrameHeader::mut_from_bytes(header.as_mut_slice()) {
        header.magic = FrameHeader::MAGIC;
        header.abi = ABI;
        header.len = layout.payload_bytes() as u32;
    }
    for _ in 0..input.up_to(8) {
        let (at, value) = (input.up_to(usize::from(u16::MAX)), input.byte());
        let bytes = if at % 8 == 0 { header.as_mut_slice() } else { payload.as_mut_slice() };
        let len = bytes.len().max(1);
        if let Some(byte) = bytes.get_mut(at / 8 % len) {
            *byte = value;
        }
    }
    let Ok(header) = FrameHeader::ref_from_bytes(header.as_slice()) else { return };
    let format = FrameFormat { layout, schema: SCHEMA };
    let Ok(view) = FrameView::new(header, payload.as_slice(), &format) else { return };
    for agent in [0, view.agents().saturating_sub(1), view.agents(), usize::MAX] {
        let seen = visible(view.observable(agent), view.present(), view.entity_task(), Some(3));
        assert!(seen.iter().all(|entity| entity < layout.shape().entities));
        let _ = (view.available(agent), view.last_actions().get(agent));
    }
    assert_eq!(view.rows().len(), layout.shape().entities * view.stride());
    assert_eq!(view.allocation_state().agents, layout.shape().agents);
    let _ = (view.episode_start(), view.header().asks_for_actions(), header.as_bytes());
}
