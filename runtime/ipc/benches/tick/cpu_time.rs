//! The processor time of this process and of its children that have ended.

pub(crate) fn cpu_time_ns() -> f64 {
    [libc::RUSAGE_SELF, libc::RUSAGE_CHILDREN].map(of).iter().sum()
}

fn of(who: libc::c_int) -> f64 {
    // SAFETY: zeros are a valid value of this structure of numbers.
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    // SAFETY: the structure is writable for the length of the call.
    let result = unsafe { libc::getrusage(who, &raw mut usage) };
    assert_eq!(result, 0);
    let ns = |time: libc::timeval| time.tv_sec as f64 * 1e9 + time.tv_usec as f64 * 1e3;
    ns(usage.ru_utime) + ns(usage.ru_stime)
}
