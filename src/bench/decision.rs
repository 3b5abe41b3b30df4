//! One decision: our plan and tract on the same observations.

use std::path::PathBuf;

use clap::Args;
use sortie_bundle::{Bundle, GoldenCase};
use sortie_core::{EntityMask, Observation, Policy};

use super::rounds::{Measured, Work, alternate, paired_ratio};
use super::{Figures, Measuring, Ratio, Row, pin};
use crate::deployment::open_bundle;
use crate::failure::Failure;
use crate::policy::{Backend, DeployedPolicy};

const TRACT_VERSION: &str = "0.23.9";

/// One decision of a bundle's agent on its golden observations: the plan and tract in alternation
///
/// Two cases: the recorded masks, and every entity visible.
#[derive(Debug, Args)]
pub(super) struct DecisionArguments {
    /// Folder of the bundle
    #[arg(default_value = "models/save-the-city")]
    bundle: PathBuf,
    #[command(flatten)]
    pub(super) measuring: Measuring,
}

pub(super) fn measure(arguments: &DecisionArguments) -> Result<Figures, Failure> {
    let bundle = open_bundle(&arguments.bundle)?;
    let mut plan = DeployedPolicy::open(&bundle, Backend::Plan)?;
    let mut tract = DeployedPolicy::open(&bundle, Backend::Tract)?;
    let (mut plan, mut tract) = (plan.policy()?, tract.policy()?);
    pin(arguments.measuring.pin)?;
    let seconds = arguments.measuring.seconds / 2.0;
    let mut figures = Figures::default();
    for case in [Case::recorded(&bundle), Case::all_visible(&bundle)] {
        let measured = {
            let mut ours = |call| case.decide(plan.as_mut(), call);
            let mut theirs = |call| case.decide(tract.as_mut(), call);
            let mut engines: [Work<'_>; 2] = [&mut ours, &mut theirs];
            alternate(&mut engines, seconds)
        };
        add(&mut figures, &case.name, &measured);
    }
    Ok(figures)
}

fn add(figures: &mut Figures, case: &str, measured: &[Measured]) {
    let engines = [("sortie", env!("CARGO_PKG_VERSION")), ("tract", TRACT_VERSION)];
    for ((engine, version), measured) in engines.into_iter().zip(measured) {
        let shown = measured.latency.percentiles();
        figures.rows.push(Row {
            what: "decision",
            case: case.to_string(),
            engine,
            version: version.to_string(),
            p50: shown.p50,
            p99: shown.p99,
            p999: shown.p999,
            max: shown.max,
            unit: "us",
        });
    }
    if let [ours, peer] = measured {
        let [ratio, low, high] = paired_ratio(&ours.medians_ns, &peer.medians_ns);
        let case = case.to_string();
        figures.ratios.push(Ratio { what: "decision", case, peer: "tract", ratio, low, high });
    }
}

/// Observations under one rule of what is visible.
struct Case<'a> {
    name: String,
    observations: Vec<Observation<'a>>,
}

impl<'a> Case<'a> {
    /// What the agents saw.
    fn recorded(bundle: &'a Bundle) -> Self {
        let cases = &bundle.golden().cases;
        let observations: Vec<_> = cases.iter().map(|case| case.observation.view()).collect();
        Self::named("recorded masks", observations)
    }

    /// The same rows with the mask forced open.
    fn all_visible(bundle: &'a Bundle) -> Self {
        let open = |case: &'a GoldenCase| Observation {
            visible: EntityMask::first(case.observation.entities()),
            ..case.observation.view()
        };
        Self::named("all visible", bundle.golden().cases.iter().map(open).collect())
    }

    fn named(name: &str, observations: Vec<Observation<'a>>) -> Self {
        let visible: usize = observations.iter().map(|seen| seen.visible.len()).sum();
        let mean = visible as f64 / observations.len().max(1) as f64;
        Self { name: format!("{name}, {mean:.1} entities"), observations }
    }

    fn decide(&self, policy: &mut dyn Policy, call: usize) {
        let observation = &self.observations[call % self.observations.len()];
        let decision = policy.decide(observation);
        std::hint::black_box(decision.expect("golden observations can be decided on"));
    }
}
