//! Chooses the widest build of the kernels that the processor offers: the same code, the same bits.

use core::fmt;

use super::OfTarget;
use super::arithmetic::Arithmetic;
pub use super::work::Work;

/// A build of the kernels that this processor can run: there is no other way to one than to ask it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Build(InstructionSet);

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum InstructionSet {
    #[cfg(test)]
    Small,
    Portable,
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    Avx2,
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    Avx512,
}

impl Build {
    /// What every processor of the target runs.
    pub const PORTABLE: Self = Self(InstructionSet::Portable);

    /// The widest build, where the feature `std` lets us ask the processor for it.
    pub fn widest() -> Self {
        #[cfg(all(feature = "std", target_arch = "x86_64"))]
        {
            if has_avx2() && has_avx512() {
                return Self(InstructionSet::Avx512);
            }
            if has_avx2() {
                return Self(InstructionSet::Avx2);
            }
        }
        Self::PORTABLE
    }

    /// All builds that this processor can run, the widest last.
    pub fn all() -> impl Iterator<Item = Self> {
        let widest = Self::widest();
        let sets = [
            #[cfg(test)]
            InstructionSet::Small,
            InstructionSet::Portable,
            #[cfg(all(feature = "std", target_arch = "x86_64"))]
            InstructionSet::Avx2,
            #[cfg(all(feature = "std", target_arch = "x86_64"))]
            InstructionSet::Avx512,
        ];
        sets.into_iter().map(Self).filter(move |build| *build <= widest)
    }

    /// Whether fused multiply-add is an instruction and not a function. Plans use it with the feature `std` alone.
    pub const fn fuses(self) -> bool {
        match self.0 {
            #[cfg(test)]
            InstructionSet::Small => false,
            InstructionSet::Portable => cfg!(target_arch = "aarch64"),
            #[cfg(all(feature = "std", target_arch = "x86_64"))]
            InstructionSet::Avx2 | InstructionSet::Avx512 => true,
        }
    }

    /// The build's name.
    pub const fn name(self) -> &'static str {
        match self.0 {
            #[cfg(test)]
            InstructionSet::Small => "small",
            InstructionSet::Portable => "portable",
            #[cfg(all(feature = "std", target_arch = "x86_64"))]
            InstructionSet::Avx2 => "avx2",
            #[cfg(all(feature = "std", target_arch = "x86_64"))]
            InstructionSet::Avx512 => "avx512",
        }
    }

    /// Runs `work` on this build's kernels.
    #[inline]
    pub fn run<A: Arithmetic, W: Work>(self, work: W) -> W::Output {
        match self.0 {
            #[cfg(test)]
            InstructionSet::Small => work.run(super::small::Small::<A>::new()),
            InstructionSet::Portable => work.run(OfTarget::<A>::new()),
            // SAFETY: a build with features comes from `widest` or `all`, which asked the processor for them.
            #[cfg(all(feature = "std", target_arch = "x86_64"))]
            #[allow(unsafe_code)]
            InstructionSet::Avx2 => unsafe { super::x86::Avx2::<A>::run(work) },
            // SAFETY: as above.
            #[cfg(all(feature = "std", target_arch = "x86_64"))]
            #[allow(unsafe_code)]
            InstructionSet::Avx512 => unsafe { super::x86::Avx512::<A>::run(work) },
        }
    }
}

impl fmt::Debug for Build {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(all(feature = "std", target_arch = "x86_64"))]
fn has_avx2() -> bool {
    std::is_x86_feature_detected!("avx2")
        && std::is_x86_feature_detected!("fma")
        && std::is_x86_feature_detected!("bmi1")
        && std::is_x86_feature_detected!("bmi2")
        && std::is_x86_feature_detected!("lzcnt")
        && std::is_x86_feature_detected!("popcnt")
}

#[cfg(all(feature = "std", target_arch = "x86_64"))]
fn has_avx512() -> bool {
    std::is_x86_feature_detected!("avx512f")
        && std::is_x86_feature_detected!("avx512bw")
        && std::is_x86_feature_detected!("avx512dq")
        && std::is_x86_feature_detected!("avx512vl")
        && std::is_x86_feature_detected!("avx512vnni")
}
