//! `sortie certify`: one hash of all decisions, the same wherever they are taken, and how far they are from the truth.

mod report;
mod targets;
mod wasm;

use std::path::{Path, PathBuf};

use clap::Args;
use sortie_bundle::{Bundle, OwnedObservation};
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::files::{Kind, try_output, write_output};
use sortie_cli::output::{Common, print_json, tell};
use sortie_cli::policy::PlanProfile;
use sortie_cli::remake::read_observations;
use sortie_cli::tools::OnnxRuntimeArguments;
use sortie_core::Observation;
use sortie_core::plan::Profile;
use sortie_plans::NetworkInput;

use self::report::{COLUMNS, Engine, Report};
use self::targets::{Target, Targets};
use crate::document::Document;
use crate::firmware::{Named, Subject};
use crate::verify::distances;

/// Observations whose truth is found at most: it takes a hundred times as long as a decision.
const TRUTHS: usize = 256;

/// Hold all decisions of a bundle, or of a plan, to one hash: on this machine and on emulated microcontrollers
///
/// Decides on all golden observations of a bundle (a plan without one: on 256 random cases) by every build of the kernels that this
/// processor runs, in the program of pages, and on boards as `sortie firmware` does, and compares a hash of all bits that come out. Exit code 1 where one
/// differs. Beside it stands how far the plan, tract and onnxruntime are from the network in double precision. What cannot be run
/// here is named, and is a failure only where --on asks for it.
///
/// The hash is of what agents decide; allocators are not part of it. It is not written into the bundle, whose id and signatures are of
/// all its files: keep it beside, and hold the bundle to it with --expect or --table.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie certify models/save-the-city
  sortie certify models/save-the-city --on host --expect f78ba41cf8168696
  sortie certify models/rover-tower-8 --on cortex-m4f,rv32imc --json
  sortie certify models/save-the-city --profile int8 --page save-the-city.md
  sortie certify models/save-the-city --table docs/evidence/certified.md
  sortie certify models/save-the-city --observations seen.bin
  sortie certify walking.plan")]
pub(crate) struct CertifyArguments {
    /// A bundle's folder, or a plan
    #[arg(value_name = "BUNDLE|PLAN")]
    subject: PathBuf,
    /// Targets beside this machine, several joined by commas; `host` is this machine alone
    /// [default: wasm,cortex-m4f,rv32imc,rv32imafc,aarch64, as far as they can be run here]
    #[arg(
        long,
        value_enum,
        value_name = "TARGETS",
        value_delimiter = ',',
        hide_possible_values = false
    )]
    on: Vec<Target>,
    /// How the plan computes [default: exact; of a plan, as it does]
    #[arg(long, value_enum)]
    profile: Option<PlanProfile>,
    /// Cases to decide on, the first so many of each network [default: all]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(1..))]
    decisions: Option<u32>,
    /// Decide on recorded observations in the place of golden ones: a record of a team that ran the bundle, or a file of
    /// `sortie eval BUNDLE --dump FILE`
    #[arg(long, value_name = "FILE")]
    observations: Option<PathBuf>,
    /// The hash that all targets must have: 16 hexadecimal digits
    #[arg(long, value_name = "HASH", value_parser = hash)]
    expect: Option<u64>,
    /// Write what was found as a Markdown page
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// A Markdown document with a table of hashes. Exit code 1 where it has another one for this
    #[arg(long, value_name = "FILE", conflicts_with = "observations")]
    table: Option<PathBuf>,
    /// Write the hash to the table instead
    #[arg(long, requires = "table")]
    write: bool,
    /// The folder `runtime/firmware` of Sortie's sources, as for `sortie firmware`
    #[arg(long, value_name = "FOLDER", env = "SORTIE_FIRMWARE")]
    sources: Option<PathBuf>,
    /// A compiler with the sources of its library, as for `sortie firmware`
    #[arg(long, value_name = "PROGRAM", default_value = "/usr/bin/rustc")]
    rustc: PathBuf,
    /// Seconds after which a board that does not end is given up
    #[arg(long, value_name = "SECONDS", default_value_t = 600, value_parser = clap::value_parser!(u64).range(1..))]
    limit: u64,
    #[command(flatten)]
    onnxruntime: OnnxRuntimeArguments,
    #[command(flatten)]
    common: Common,
}

/// A hash as it is printed.
fn hash(text: &str) -> Result<u64, String> {
    let wrong = || "expected 16 hexadecimal digits".to_owned();
    let hash = u64::from_str_radix(text, 16).map_err(|_| wrong())?;
    if text.len() == 16 { Ok(hash) } else { Err(wrong()) }
}

pub(crate) fn run(arguments: &CertifyArguments) -> Outcome {
    let named = Named::open(&arguments.subject, arguments.profile.map(PlanProfile::profile))?;
    if let Some(page) = &arguments.page {
        try_output(page, Kind::Certificate)?;
    }
    let most = arguments.decisions.map_or(usize::MAX, |most| most as usize);
    let profile = arguments.profile.unwrap_or(PlanProfile::Exact).profile();
    let mut report = match &named {
        Named::Bundle(bundle) => of_bundle(arguments, bundle, profile, most)?,
        Named::Plan(path, plan) => {
            if arguments.observations.is_some() {
                let message = "recorded observations belong to a bundle: name its folder";
                return Err(Failure::new(Exit::Usage, message));
            }
            let part = Subject::of_plan(path, plan, arguments.common.seed, most)?;
            let mut report = report_of(arguments, path, &[part])?;
            report.observations = "random cases".to_owned();
            report.unjudged =
                Some("a plan does not hold the network that it was made from".to_owned());
            report
        }
    };
    report.expect(arguments.expect);
    if arguments.common.json {
        print_json(&report);
    } else {
        report.print();
    }
    if let Some(page) = &arguments.page {
        write_output(page, report.page().as_bytes())?;
    }
    report.judge()?;
    match &arguments.table {
        Some(table) => compare(table, &report, arguments.write),
        None => Ok(()),
    }
}

/// A bundle on its golden observations, or on recorded ones.
fn of_bundle(
    arguments: &CertifyArguments,
    bundle: &Bundle,
    profile: Profile,
    most: usize,
) -> Result<Report, Failure> {
    let recorded = arguments.observations.as_deref();
    let recorded = recorded.map(|file| read_observations(file, bundle)).transpose()?;
    let parts = Subject::all_of_bundle(bundle, profile, recorded.as_ref(), most)?;
    let mut report = report_of(arguments, bundle.folder(), &parts)?;
    report.observations = match &arguments.observations {
        Some(file) => format!("observations of {}", file.display()),
        None if bundle.options().is_some() => "golden episodes".to_owned(),
        None => "golden observations".to_owned(),
    };
    if bundle.options().is_some() {
        let reason = "which network an agent of options asks depends on what others answer; `sortie verify` judges each by itself";
        report.unjudged = Some(reason.to_owned());
        return Ok(report);
    }
    let inputs: Vec<NetworkInput> = match &recorded {
        Some(recorded) => recorded.observations().take(TRUTHS.min(most)).map(owned).collect(),
        None => {
            let cases = bundle.golden().cases.iter().take(TRUTHS.min(most));
            cases.map(|case| case.observation.clone().into()).collect()
        }
    };
    let runtime = arguments.onnxruntime.open_or_note("onnxruntime is not compared")?;
    if runtime.is_none() {
        report.not_compared.push("onnxruntime");
    }
    let found = distances(bundle, profile, inputs, (runtime, arguments.common.seed))?;
    report.engines = found.into_iter().map(|(name, found)| Engine::new(name, found)).collect();
    if report.engines.is_empty() {
        report.unjudged = Some("its networks are not known in double precision".to_owned());
    }
    Ok(report)
}

/// The hashes of every target.
fn report_of(
    arguments: &CertifyArguments,
    path: &Path,
    parts: &[Subject],
) -> Result<Report, Failure> {
    let targets = Targets::new(arguments);
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let profile = parts.first().map_or("", |part| part.profile.name());
    let (host, not_run) = targets.host(parts)?;
    let mut report = Report::new(name, profile, host);
    report.not_run = not_run;
    targets.wasm(parts, &mut report)?;
    targets.boards(parts, &mut report)?;
    Ok(report)
}

fn owned(seen: Observation<'_>) -> NetworkInput {
    let rows = seen.rows.to_vec();
    let seen = OwnedObservation {
        rows,
        features: seen.stride,
        last_actions: seen.last_actions.to_vec(),
        visible: seen.visible,
        self_index: seen.self_index,
        available: seen.available.to_vec(),
    };
    seen.into()
}

/// Holds a hash to a table, or writes it there.
fn compare(path: &Path, report: &Report, write: bool) -> Outcome {
    let (mut document, row) = (Document::open(path, COLUMNS, write)?, report.row());
    if write {
        document.put(row);
        return write_output(path, document.write().as_bytes());
    }
    let within = |said: &str| format!("{}: {said}", path.display());
    match document.same(&row).and_then(|recorded| recorded.last()) {
        None => tell!("note: {}", within("nothing is recorded of this; `--write` does")),
        Some(recorded) if *recorded == report.hash => {}
        Some(recorded) => {
            let said = format!("hash: {}, recorded {recorded}", report.hash);
            return Err(Failure::difference(within(&said)));
        }
    }
    Ok(())
}
