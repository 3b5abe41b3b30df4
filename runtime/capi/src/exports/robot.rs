//! What a robot must know of its policy beside the numbers. Where a plan does not say, lists are empty.

use core::ffi::{CStr, c_char};
use core::ptr;

use sortie_core::plan::{Fact, Normaliser, Robot};

use crate::placed::Placed;
use crate::policy::SortiePolicy;

/// A list that a plan has of its robot, from the metadata of the file that it was made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum SortieFact {
    /// Joints in the order of actions: names.
    JointNames = 0,
    /// Angles or lengths in which the robot stands, radians or metres: numbers.
    DefaultJointPos = 1,
    /// What an action is multiplied by; one number, or one for each joint.
    ActionScale = 2,
    /// Gains of the joints' position control, Nm/rad or N/m: numbers.
    Stiffness = 3,
    /// Gains of their velocity, Nms/rad or Ns/m: numbers.
    Damping = 4,
    /// What the observation consists of: names.
    ObservationNames = 5,
}

/// Whether the network itself normalises what it observes by the means and deviations of its training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum SortieNormaliser {
    /// The plan does not say.
    Unknown = 0,
    /// It does not: whoever calls it normalises, if it was trained so.
    None = 1,
    /// It does.
    InFile = 2,
}

/// Number of names or numbers of a list, a `SortieFact`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_fact_count(policy: *const SortiePolicy, fact: i32) -> usize {
    // SAFETY: as the caller promises.
    let Some((robot, fact)) = (unsafe { asked(policy, fact) }) else { return 0 };
    robot.names(fact).count().max(robot.numbers(fact).count())
}

/// The name at `index` of a list of names, which stands in the plan; NULL where there is none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_fact_name(
    policy: *const SortiePolicy,
    fact: i32,
    index: usize,
) -> *const c_char {
    // SAFETY: as the caller promises.
    let Some((robot, fact)) = (unsafe { asked(policy, fact) }) else { return ptr::null() };
    robot.names(fact).nth(index).map_or(ptr::null(), CStr::as_ptr)
}

/// The number at `index` of a list of numbers; NaN where there is none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_fact_number(
    policy: *const SortiePolicy,
    fact: i32,
    index: usize,
) -> f32 {
    // SAFETY: as the caller promises.
    let Some((robot, fact)) = (unsafe { asked(policy, fact) }) else { return f32::NAN };
    robot.numbers(fact).nth(index).unwrap_or(f32::NAN)
}

/// Whether the network normalises what it observes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_normaliser(policy: *const SortiePolicy) -> SortieNormaliser {
    // SAFETY: as the caller promises.
    let policy = unsafe { SortiePolicy::at(policy) };
    match policy.ok().and_then(|policy| policy.robot).map(|robot| robot.normaliser()) {
        Some(Normaliser::None) => SortieNormaliser::None,
        Some(Normaliser::File) => SortieNormaliser::InFile,
        _ => SortieNormaliser::Unknown,
    }
}

/// # Safety
/// `policy` is null or comes from `sortie_load`.
unsafe fn asked(policy: *const SortiePolicy, fact: i32) -> Option<(Robot<'static>, Fact)> {
    let fact = *Fact::ALL.get(usize::try_from(fact).ok()?)?;
    // SAFETY: as the caller promises.
    let policy = unsafe { SortiePolicy::at(policy) };
    Some((policy.ok()?.robot?, fact))
}
