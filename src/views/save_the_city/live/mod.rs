//! A team in its cities as a page in which it plays: the program of `runtime/browser`, the plans, and a script around them.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;
use sortie_bundle::{Bundle, SubtaskConditioning, hex};
use sortie_core::plan::{Plan, Profile};
use sortie_plans::CompileError;
use sortie_stage::save_the_city::{Player, golden_hash, memory};
use sortie_stage::{Cast, GoldenObservation, StageError};

use crate::compiler::{compiler, plans};
use crate::environment::{ScenarioSetName, check_fits};
use crate::failure::{Exit, Failure};
use crate::views::page::{Web, html_with_program, script, style};
use crate::views::{Hashes, Live, Wanted};

/// The program that pages run, packed; `.ci/browser` builds it.
const PROGRAM: &[u8] = include_bytes!("../../../../runtime/browser/page.wasm.gz");

/// Decisions that page and host compare.
const DECISIONS: u64 = 10_000;

const KEYS: &str = include_str!("web/keys.html");
const WEB: Web = Web {
    styles: &[
        include_str!("../page/web/colours.css"),
        style::BASICS,
        include_str!("../page/web/focus.css"),
        style::LAYOUT,
        include_str!("../page/web/desk.css"),
        style::RESULT,
        include_str!("../page/web/map.css"),
        style::PLAYBACK,
        include_str!("../page/web/timeline.css"),
        style::AGENT,
        include_str!("../page/web/buildings.css"),
        style::DIALOG,
        include_str!("web/live.css"),
    ],
    map: include_str!("web/map.html"),
    panels: concat!(include_str!("../page/web/panels.html"), include_str!("web/panel.html")),
    scripts: &[
        include_str!("web/program.js"),
        include_str!("../page/web/status.js"),
        script::SUMS,
        include_str!("../page/web/entities.js"),
        script::NUMBERS,
        script::ELEMENTS,
        include_str!("../page/web/signs.js"),
        include_str!("../page/web/map.js"),
        include_str!("../page/web/agent.js"),
        include_str!("../page/web/building.js"),
        include_str!("../page/web/timeline.js"),
        script::PLAYER,
        include_str!("web/deeds.js"),
        include_str!("web/bits.js"),
        include_str!("web/begin.js"),
    ],
};

/// What the page's script knows before it plays.
#[derive(Serialize)]
struct Data<'a> {
    subject: String,
    env: String,
    /// What is played where the address says nothing; the seed as text, which no number of a script could hold.
    seed: String,
    number: usize,
    hashes: &'a Hashes,
    notes: [String; 2],
    program: String,
    cast: String,
}

/// The page in which a bundle's team plays, and the hashes that it shows. `program` is another build of its program.
pub(super) fn live(
    wanted: &Wanted<'_>,
    bundle: &Bundle,
    program: Option<&[u8]>,
) -> Result<Live, Failure> {
    let set = wanted.set.clone().unwrap_or_default();
    check_fits(bundle, &set)?;
    let within = |error: Failure| error.within(bundle.folder().display());
    let cast = cast(bundle, &set).map_err(within)?;
    let hashes = hashes(&cast, wanted.seed)
        .map_err(|error| Failure::new(Exit::BadData, error.to_string()))
        .map_err(within)?;
    let bytes = cast.to_bytes().map_err(|error| Failure::new(Exit::Bug, error.to_string()))?;
    let data = Data {
        subject: wanted.subject.display().to_string(),
        env: set.to_string(),
        seed: wanted.seed.to_string(),
        number: wanted.episode,
        hashes: &hashes,
        notes: [
            format!("Bundle {}.", &hex(bundle.id())[..16]),
            "World, agents and allocator run in this page, by the code of `sortie`; nothing is loaded and nothing is sent."
                .to_owned(),
        ],
        program: STANDARD.encode(program.unwrap_or(PROGRAM)),
        cast: STANDARD.encode(bytes),
    };
    Ok(Live { html: html_with_program(&WEB, &data, KEYS), hashes })
}

/// All that plays: plans, which have given the bundle's golden answers, and what they are asked.
fn cast(bundle: &Bundle, set: &ScenarioSetName) -> Result<Cast, Failure> {
    let contract = bundle.contract();
    let agents = plans().agents(bundle, Profile::Exact)?;
    let allocator = plans().allocator(bundle)?;
    let ([agent], Some(allocator)) = (agents.plans(), allocator) else {
        return Err(refused());
    };
    let remembers = Plan::load(agent.as_slice()).map_err(CompileError::from)?.hidden() > 0;
    if remembers || contract.subtask_conditioning != SubtaskConditioning::Mask {
        return Err(refused());
    }
    let features = usize::from(contract.features);
    let golden = bundle.golden().cases.iter();
    let limits = bundle.manifest().limits;
    Ok(Cast {
        set: set.set().to_owned(),
        contract: contract.hash(),
        decision_interval: contract.decision_interval,
        safe_action: contract.safe_action,
        entities: limits.n_max,
        tasks: limits.t_max,
        team_max: limits.team_max,
        agent: agent.as_slice().to_vec(),
        allocator: allocator.as_slice().to_vec(),
        attention: compiler().attention(bundle.agent_onnx())?,
        golden: golden
            .map(|case| GoldenObservation::new(&case.observation.view(), features))
            .collect(),
    })
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
    let message = "a page plays teams that decide by one network without memory, in the subtask that they are \
                   given, and that have learned an allocator which values teams";
    Failure::new(Exit::Usage, message)
}
