//! What the processes of a domain say to each other, byte by byte (ABI 3).
//!
//! Little endian, no implicit padding, every bit pattern valid. A message type that changes
//! gets a new ABI number: the transport compares only names, sizes and alignments.

mod action;
mod allocation;
mod control;
mod frame_fill;
mod frame_header;
mod frame_layout;
mod frame_view;
mod private_frame;
mod served;
mod status;
mod swap;
#[cfg(test)]
mod tests;

pub use action::ActionMsg;
pub use allocation::{AllocMsg, AllocationFault};
pub use control::{Command, ControlRep, ControlReq, ControlStatus};
pub use frame_fill::FrameMut;
pub use frame_header::{FrameHeader, FrameKind};
#[cfg(feature = "serial")]
pub(crate) use frame_layout::payload_bytes;
pub use frame_layout::{FrameFormat, FrameHead, FrameLayout, LayoutError};
pub use frame_view::{FrameError, FrameView};
pub use served::{
    AnswerHead, AnswerStatus, AnswerView, MessageError, ObservationHead, ObservationView, Reason,
    ServedFormat,
};
pub use status::{Role, StatMsg};
pub use swap::{SwapMoment, SwapOrder, TurnBack};

#[cfg(target_endian = "big")]
compile_error!("the wire format is little endian and read in place");

/// Number of this wire format; a message of another one is dropped.
pub const ABI: u16 = 3;

/// Asserts at compile time that a message has the stated size and field offsets, and no field
/// beyond them.
macro_rules! assert_layout {
    ($message:ident, $size:literal, { $($field:ident : $offset:literal),+ $(,)? }) => {
        const _: () = {
            assert!(core::mem::size_of::<$message>() == $size);
            $(assert!(core::mem::offset_of!($message, $field) == $offset);)+
            // Exhaustive: a field that the list forgets stops the build here.
            const fn _all_fields_are_listed(message: $message) {
                let $message { $($field: _),+ } = message;
            }
        };
    };
}
use assert_layout;
