//! The wire types as iceoryx2 wants them: named, and marked as sendable by its own traits, which
//! cannot be implemented for types of another crate.

use iceoryx2::prelude::ZeroCopySend;
use sortie_core::wire::{ActionMsg, AllocMsg, ControlRep, ControlReq, FrameHeader, StatMsg};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout, transmute, transmute_ref};

/// A wire message inside an iceoryx2 payload.
pub(super) trait Message: ZeroCopySend + std::fmt::Debug + Copy + 'static {
    type Wire;

    fn wrap(message: &Self::Wire) -> Self;
    fn message(&self) -> &Self::Wire;
}

macro_rules! message {
    ($payload:ident, $wire:ident, $name:literal, $words:literal) => {
        #[doc = concat!("Payload `", $name, "`.")]
        #[derive(
            Clone, Copy, Debug, ZeroCopySend, FromBytes, IntoBytes, Immutable, KnownLayout,
        )]
        #[repr(C)]
        #[repr(align(64))]
        #[type_name($name)]
        pub(super) struct $payload([u64; $words]);

        impl Message for $payload {
            type Wire = $wire;

            fn wrap(message: &$wire) -> Self {
                transmute!(*message)
            }

            fn message(&self) -> &$wire {
                transmute_ref!(self)
            }
        }
    };
}

message!(ActionPayload, ActionMsg, "sortie.ActionMsg.v1", 8);
message!(AllocPayload, AllocMsg, "sortie.AllocMsg.v1", 16);
message!(StatPayload, StatMsg, "sortie.StatMsg.v1", 64);
message!(RequestPayload, ControlReq, "sortie.ControlReq.v1", 8);
message!(AnswerPayload, ControlRep, "sortie.ControlRep.v1", 32);
message!(FrameHeaderPayload, FrameHeader, "sortie.FrameHeader.v1", 8);

impl Default for FrameHeaderPayload {
    fn default() -> Self {
        Self::wrap(&FrameHeader::default())
    }
}
