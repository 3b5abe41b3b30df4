//! Runs loops in the widest build that the processor offers: the same code, the same bits.

/// A computation that can be built for several instruction sets; `run` is to be `#[inline(always)]`.
pub trait Work {
    /// What it computes.
    type Output;

    /// Computes it.
    fn run(self) -> Self::Output;
}

/// Runs `work` with AVX2 where the processor has it; else as it is.
#[inline]
pub fn run_widest<W: Work>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx2") {
        // SAFETY: the only obligation of calling a function with target features is that the processor has
        // them, which the line above asked.
        #[expect(unsafe_code, reason = "half of an update is loops, which AVX2 halves")]
        return unsafe { with_avx2(work) };
    }
    work.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2<W: Work>(work: W) -> W::Output {
    work.run()
}
