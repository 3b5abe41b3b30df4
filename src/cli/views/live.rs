//! A team in its world as a page in which it plays: the program of `runtime/browser`, the plans, and a script around them.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use miniz_oxide::deflate::compress_to_vec_zlib;
use serde::Serialize;
use sortie_bundle::{Bundle, SubtaskConditioning, hex};
use sortie_core::plan::Profile;
use sortie_pages::live_page;
use sortie_stage::{
    AllocatorCast, Cast, GoldenObservation, OptionSettings, Player, StageError, golden_hash, memory,
};

use super::Wanted;
use super::probes::attention_of;
use crate::environment::{ScenarioSetName, check_fits, check_relations};
use crate::failure::{Exit, Failure};
use crate::tools::plans;

/// The program that pages run, packed; `.ci/browser` builds it.
pub const PAGE_PROGRAM: &[u8] = include_bytes!("../../../runtime/browser/page.wasm.gz");

/// Decisions that page and host compare.
const DECISIONS: u64 = 10_000;
/// How hard plans are packed: the best that is worth its time.
const PACKING: u8 = 9;

/// What the page's script knows before it plays.
#[derive(Serialize)]
struct Data<'a> {
    subject: String,
    env: String,
    /// What is played where the address says nothing; the seed as text, which no number of a script could hold.
    seed: String,
    number: usize,
    hashes: &'a Hashes,
    notes: Vec<String>,
    program: String,
    /// Packed by zlib.
    cast: String,
}

/// A page in which a team plays.
pub(crate) struct Live {
    pub(crate) html: String,
    pub(crate) hashes: Hashes,
}

/// What a page computes if it has the bits of this machine.
#[derive(Debug, Serialize)]
pub(crate) struct Hashes {
    /// FNV-1a over the utilities of the bundle's golden observations.
    pub(crate) golden: String,
    /// The same over those of the first decisions in the episodes of a seed.
    pub(crate) played: String,
    pub(crate) decisions: u64,
    pub(crate) seed: String,
}

/// The page in which a bundle's team plays, and the hashes that it shows. `program` is another build of its program.
pub(crate) fn live(
    wanted: &Wanted<'_>,
    bundle: &Bundle,
    set: &ScenarioSetName,
    program: Option<&[u8]>,
) -> Result<Live, Failure> {
    check_fits(bundle, set)?;
    let within = |error: Failure| error.within(bundle.folder().display());
    let cast = cast(bundle, set).map_err(within)?;
    let hashes = hashes(&cast, wanted.seed)
        .map_err(|error| Failure::new(Exit::BadData, error.to_string()))
        .map_err(within)?;
    let bytes = cast.to_bytes().map_err(|error| Failure::new(Exit::Bug, error.to_string()))?;
    let notes = vec![
        format!("Bundle {}.", &hex(bundle.id())[..16]),
        "The world and the team run in this page, by the code of `sortie`; nothing is loaded and nothing is sent."
            .to_owned(),
    ];
    let data = Data {
        subject: wanted.name(),
        env: set.to_string(),
        seed: wanted.seed.to_string(),
        number: wanted.episode,
        hashes: &hashes,
        notes,
        program: STANDARD.encode(program.unwrap_or(PAGE_PROGRAM)),
        cast: STANDARD.encode(compress_to_vec_zlib(&bytes, PACKING)),
    };
    Ok(Live { html: live_page(&data), hashes })
}

/// All that plays: plans, which have given the bundle's golden answers, and what they are asked.
pub fn cast(bundle: &Bundle, set: &ScenarioSetName) -> Result<Cast, Failure> {
    let contract = bundle.contract();
    let agents = plans().agents(bundle, Profile::Exact)?;
    let allocator = allocator(bundle)?;
    // Agents that act for subtasks need somebody who assigns them.
    let conditioning = match &allocator {
        Some(_) => SubtaskConditioning::Mask,
        None => SubtaskConditioning::None,
    };
    if contract.subtask_conditioning != conditioning {
        return Err(refused());
    }
    let rules = bundle.options().map(|options| options.rules(contract.actions.into()));
    let rules = rules.transpose().map_err(|reason| Failure::new(Exit::BadData, reason))?;
    let features = usize::from(contract.features);
    let golden = bundle.golden().cases.iter();
    Ok(Cast {
        environment: set.entry().name.to_owned(),
        set: set.set().to_owned(),
        contract: contract.hash(),
        decision_interval: contract.decision_interval,
        safe_action: contract.safe_action,
        plans: agents.plans().iter().map(|plan| plan.as_slice().to_vec()).collect(),
        plan_of: bundle.manifest().network.graph_of.clone(),
        options: rules.as_ref().map(OptionSettings::from),
        allocator,
        attention: attention_of(bundle)?,
        golden: golden
            .map(|case| GoldenObservation::new(&case.observation.view(), features))
            .collect(),
    })
}

/// What allocates, if it has learned to value teams or to point at subtasks.
fn allocator(bundle: &Bundle) -> Result<Option<AllocatorCast>, Failure> {
    check_relations(bundle)?;
    let limits = bundle.manifest().limits;
    let pointing = plans().pointing(bundle)?.map(|memory| AllocatorCast::Pointing {
        plans: memory.plans().each_ref().map(|plan| plan.as_slice().to_vec()),
        exclusive: memory.rules().exclusive,
        first_action: memory.rules().first_action,
    });
    let values = plans().allocator(bundle, Profile::Exact)?.map(|plan| AllocatorCast::TeamValue {
        plan: plan.as_slice().to_vec(),
        entities: limits.n_max,
        tasks: limits.t_max,
        team_max: limits.team_max,
    });
    Ok(pointing.or(values))
}

/// The golden utilities, and those of the first decisions that the team takes in the episodes of a seed.
fn hashes(cast: &Cast, seed: u64) -> Result<Hashes, StageError> {
    let mut memory = memory(cast)?;
    let mut player = Player::new(&mut memory, cast, seed, 0)?;
    while player.rehearse(DECISIONS)? < DECISIONS {}
    Ok(Hashes {
        golden: format!("{:016x}", golden_hash(cast)?),
        played: format!("{:016x}", player.rehearsed()),
        decisions: DECISIONS,
        seed: seed.to_string(),
    })
}

fn refused() -> Failure {
    let message = "a page plays teams whose agents act for no subtasks, or for those that an allocator gives them \
                   which has learned to value teams or to point at subtasks";
    Failure::new(Exit::Usage, message)
}
