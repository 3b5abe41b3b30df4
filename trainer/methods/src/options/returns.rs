//! What steps led to: returns, and where values are looked up behind them.

use sortie_learn::trajectory::{End, Place};

use super::replay::{Note, Replay};

/// How steps become returns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReturnRules {
    /// Steps before a value is looked up.
    pub(crate) steps: u8,
    pub(crate) discount: f32,
    /// Whether actions that change nothing are worth nothing.
    pub(crate) no_operations: bool,
    /// Whether steps behind which time was over, or nothing could be reached any more, are learned from; else what comes
    /// before them ends where they begin.
    pub(crate) time_outs: bool,
}

/// What a step is to who learns from it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Paid {
    pub(crate) reward: f32,
    /// Whether no later step belongs to the return.
    pub(crate) is_last: bool,
    /// Whether it has come to what it was for, behind which nothing is worth anything.
    pub(crate) is_over: bool,
}

/// A value that belongs to what was earned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Next {
    pub(crate) place: Place,
    /// What it counts.
    pub(crate) discount: f32,
    /// The actions that could be chosen there, as bits.
    pub(crate) mask: u32,
}

/// What steps from one on earned, and where a value is looked up behind them, if anywhere; none where that is not known
/// yet, or is not learned from.
pub(crate) fn returns(
    replay: &Replay,
    start: Place,
    rules: ReturnRules,
    pay: impl Fn(&Note, End) -> Paid,
) -> Option<(f32, Option<Next>)> {
    let (mut discount, mut earned, steps) = (1.0, 0.0, usize::from(rules.steps));
    for step in 0..steps {
        let place = start.after(step);
        if !replay.steps.has(place) {
            return None;
        }
        let (note, end) = (replay.steps.note(place), replay.steps.end(place));
        let before = Next { place, discount, mask: u32::MAX };
        if rules.no_operations && note.changed_nothing {
            // What changes nothing is worth nothing as a start; behind other steps it is not followed.
            return Some(if step == 0 { (0.0, None) } else { (earned, Some(before)) });
        }
        let Paid { reward, is_last, is_over } = pay(note, end);
        if is_last && !is_over && !rules.time_outs {
            return (step > 0).then_some((earned, Some(before)));
        }
        earned += discount * reward;
        if is_over || end == End::Over {
            return Some((earned, None));
        }
        discount *= rules.discount;
        if is_last || step + 1 == steps {
            let next = Next { place: place.after(1), discount, ..before };
            return replay.steps.has(next.place).then_some((earned, Some(next)));
        }
    }
    None
}

#[cfg(test)]
mod tests;
