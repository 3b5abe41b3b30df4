//! Whether the leading allocator answers: one that is stopped keeps its lock, and only its death frees it.

/// Questions that a leader may leave unanswered.
const PATIENCE: u32 = 5;

/// Counts the allocations asked for since the last one that came.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Vigil {
    answered: u64,
    asked: u64,
    missed: u32,
}

impl Vigil {
    /// An allocation of this tick was seen.
    pub(super) fn answered(&mut self, tick: u64) {
        if tick > self.answered {
            self.answered = tick;
            self.missed = 0;
        }
    }

    /// The newest tick that asked for an allocation. Some may have passed unseen: it counts too few.
    pub(super) fn asked(&mut self, decision_tick: u64) {
        if decision_tick > self.asked {
            self.asked = decision_tick;
            self.missed += u32::from(decision_tick > self.answered);
        }
    }

    /// Whether a leader has had its chances.
    pub(super) fn is_silent(&self) -> bool {
        self.missed >= PATIENCE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leader_is_silent_after_five_questions_without_an_answer() {
        let mut vigil = Vigil::default();
        for tick in [4, 8, 12, 12, 12, 16] {
            vigil.asked(tick);
        }
        assert!(!vigil.is_silent());
        vigil.answered(12);
        for tick in [20, 24, 28, 32] {
            vigil.asked(tick);
            vigil.answered(12);
        }
        assert!(!vigil.is_silent());
        vigil.asked(36);
        assert!(vigil.is_silent());
        vigil.answered(36);
        assert!(!vigil.is_silent());
    }
}
