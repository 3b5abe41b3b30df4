//! `sortie doctor`: what is wrong with the machine, or with a domain, and what to do.

use clap::Args;
use serde::Serialize;
use sortie_ipc::{Domain, Finding, Severity, examine};

use crate::failure::{Failure, Outcome};
use crate::output::{Common, print_json, say};

/// Say what is wrong with this machine, or with a running domain, and what to do about it
///
/// Exit code 1 where something will not work.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie doctor
  sortie doctor --domain north --json")]
pub(crate) struct DoctorArguments {
    /// Domain to look at
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    #[command(flatten)]
    common: Common,
}

/// What was found, for scripts.
#[derive(Serialize)]
struct Found<'a> {
    domain: &'a str,
    version: &'static str,
    problems: usize,
    findings: Vec<FoundOne<'a>>,
}

#[derive(Serialize)]
struct FoundOne<'a> {
    check: &'a str,
    severity: &'static str,
    found: &'a str,
    advice: &'a str,
}

pub(crate) fn run(arguments: &DoctorArguments) -> Outcome {
    let domain = Domain::new(&arguments.domain)?;
    let findings = examine(&domain)?;
    let problems = findings.iter().filter(|found| found.severity == Severity::Problem).count();
    if arguments.common.json {
        print_json(&Found {
            domain: domain.id(),
            version: env!("CARGO_PKG_VERSION"),
            problems,
            findings: findings.iter().map(FoundOne::new).collect(),
        });
    } else {
        say!("sortie {}, domain `{}`", env!("CARGO_PKG_VERSION"), domain.id());
        findings.iter().for_each(print);
    }
    match problems {
        0 => Ok(()),
        1 => Err(Failure::difference("1 problem")),
        count => Err(Failure::difference(format!("{count} problems"))),
    }
}

impl<'a> FoundOne<'a> {
    fn new(finding: &'a Finding) -> Self {
        let Finding { check, found, advice, .. } = finding;
        Self { check, severity: name(finding.severity), found, advice }
    }
}

fn name(severity: Severity) -> &'static str {
    match severity {
        Severity::Fine => "fine",
        Severity::Warning => "warning",
        Severity::Problem => "problem",
    }
}

fn print(finding: &Finding) {
    say!("{:8} {:20} {}", name(finding.severity), finding.check, finding.found);
    if !finding.advice.is_empty() {
        say!("{:8} {:20} to do: {}", "", "", finding.advice);
    }
}
