//! Runs loops in the widest build that the processor offers: the same code, the same bits.

/// Runs `work` with AVX2 where the processor has it; else as it is. What is to be built for both is `#[inline(always)]`,
/// `work` itself and all that it calls.
#[inline]
pub fn run_widest<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx2") {
        // SAFETY: the only obligation of calling a function with target features is that the processor has
        // them, which the line above asked.
        #[expect(unsafe_code, reason = "half of an update is loops, which AVX2 halves")]
        return unsafe { with_avx2(work) };
    }
    work()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2<R>(work: impl FnOnce() -> R) -> R {
    work()
}

/// The same of work that has a width: the usual ones are constants, which unrolls its loops and leaves no checks in them.
#[inline]
pub(super) fn run_with_width(width: usize, work: impl FnOnce(usize)) {
    run_widest(
        #[inline(always)]
        || match width {
            32 => work(32),
            64 => work(64),
            128 => work(128),
            width => work(width),
        },
    );
}
