//! Plans that are not loaded: damaged ones, and those of a profile that this build does not have.

use sortie_core::include_plan;
use sortie_core::plan::{HEADER_BYTES, Header, Part, Plan, PlanError, Profile, checksums};

const AGENT: &[u8] = include_plan!("../../../../tests/golden/plans/agent-2.0.plan");

/// A plan where its alignment demands it, whether or not the core has an allocator's help.
#[repr(C, align(64))]
struct Aligned([u8; 1 << 18]);

fn load(plan: &[u8]) -> Result<(), PlanError> {
    let mut aligned = Box::new(Aligned([0; 1 << 18]));
    let bytes = &mut aligned.0[..plan.len()];
    bytes.copy_from_slice(plan);
    Plan::load(bytes).map(drop)
}

#[test]
fn every_damaged_byte_of_a_plan_is_noticed() {
    let (header, _) = Header::read(AGENT).expect("the golden plan");
    let (program, weights) = (header.program_offset as usize, header.weights_offset as usize);
    assert_eq!(load(AGENT), Ok(()));
    let damaged = |byte: usize| {
        let mut plan = AGENT.to_vec();
        plan[byte] ^= 1;
        load(&plan)
    };
    // What says what the file is, where its parts are and what it needs is read before the checksum.
    for byte in 0..HEADER_BYTES {
        assert!(damaged(byte).is_err(), "byte {byte} of the header");
    }
    let source = 68..100;
    for byte in source.chain(program..program + header.program_len as usize) {
        assert_eq!(damaged(byte), Err(PlanError::Crc(Part::Program)), "byte {byte}");
    }
    for byte in (weights..weights + header.weights_len as usize).step_by(61) {
        assert_eq!(damaged(byte), Err(PlanError::Crc(Part::Weights)), "byte {byte}");
    }
}

#[test]
fn a_fused_plan_is_run_fused_or_refused() {
    let (header, _) = Header::read(AGENT).expect("the golden plan");
    let fused = Header { profile: Profile::Fused, ..header };
    let (program, weights) = (header.program_offset as usize, header.weights_offset as usize);
    let sums = checksums(
        &fused,
        &AGENT[program..program + header.program_len as usize],
        &AGENT[weights..weights + header.weights_len as usize],
    );
    let mut plan = AGENT.to_vec();
    plan[..HEADER_BYTES].copy_from_slice(&fused.to_bytes(sums));
    let refused = Err(PlanError::WrongProfile { got: Profile::Fused.id() });
    // The instruction alone is not enough: without `std` nothing in the core fuses, whatever the processor.
    if !cfg!(feature = "std") {
        assert_eq!(load(&plan), refused);
    } else {
        #[cfg(target_arch = "x86_64")]
        let fuses = std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma");
        #[cfg(not(target_arch = "x86_64"))]
        let fuses = cfg!(target_arch = "aarch64");
        assert_eq!(load(&plan), if fuses { Ok(()) } else { refused });
    }
}
