//! What a world says, counts and waits for, case by case.

mod seats;
mod stage;
mod telling;
mod waiting;
