//! What only the second program does.

mod hostile_onnx;
mod storm;
mod yard;
