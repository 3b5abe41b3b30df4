//! What was found, for people, and whether it is good enough.

use sortie_plans::{LEAST_AGREEMENT, RECORDED, TOLERANCE};

use super::{Compared, Report};
use sortie_cli::failure::{Failure, Outcome};
use sortie_cli::output::{Table, say};

pub(super) fn print(report: &Report) {
    for engine in &report.engines {
        say!("{}", engine.name);
        let mut table = Table::new(&HEADER);
        for family in &engine.families {
            let note = if family.judged { "" } else { "*" };
            table.row([
                format!("  {}{note}", family.name),
                family.inputs.to_string(),
                format!("{:.1e}", family.max_rel_error),
                family.action_mismatches.to_string(),
                family.refused.to_string(),
                family.refusals_differ.to_string(),
                family.swallowed.to_string(),
            ]);
        }
        table.print();
        say!();
    }
    say!("{NOTE}");
}

pub(super) fn print_recorded(report: &Report) {
    for engine in &report.engines {
        say!("{}", engine.name);
        let mut table = Table::new(&["  output", "cases", "error", "other"]);
        for output in &engine.families {
            table.row([
                format!("  {}", output.name),
                output.inputs.to_string(),
                format!("{:.1e}", output.max_rel_error),
                output.action_mismatches.to_string(),
            ]);
        }
        table.print();
        say!();
    }
    say!("error: the largest |a - b| / (1 + |b|); other: another action");
    if let Some(engine) = report.engine {
        say!("{engine}");
    }
}

const HEADER: [&str; 7] =
    ["  family", "inputs", "error", "other", "refused", "one-sided", "swallowed"];

const NOTE: &str = "\
error: the largest relative one; other: another action or allocation
*: shown, not judged
refused: the plan returns an error, and the other engine's numbers are not
finite or no action is available; one-sided: only one of them answered
swallowed: refused, where the other engine made a number of NaN or infinity";

/// Other actions in real situations count: golden and recorded ones. Elsewhere only one engine's refusal does, and
/// whatever the allocator's plan, which is exact, gives.
pub(super) fn judge_actions(report: &Report) -> Outcome {
    let (allocators, agents): (Vec<_>, Vec<_>) =
        report.engines.iter().partition(|engine| engine.name.starts_with("allocator"));
    for engine in agents {
        for family in &engine.families {
            let real = ["golden", RECORDED].contains(&family.name.as_str());
            let other = family.action_mismatches as f64 / family.inputs.max(1) as f64;
            if real && other > 1.0 - LEAST_AGREEMENT || family.judged && family.refusals_differ > 0
            {
                return Err(Failure::difference(format!(
                    "{}, {}: {} other choices on {} inputs (limit {:.1} %), {} inputs that only one answers",
                    engine.name,
                    family.name,
                    family.action_mismatches,
                    family.inputs,
                    100.0 * (1.0 - LEAST_AGREEMENT),
                    family.refusals_differ
                )));
            }
        }
    }
    judge(allocators)
}

/// Another choice within the tolerance is a near tie, but for golden observations, which have none.
pub(super) fn judge<'a>(engines: impl IntoIterator<Item = &'a Compared>) -> Outcome {
    for engine in engines {
        for family in &engine.families {
            let other_action = family.action_mismatches > 0 && family.name == "golden";
            if !family.agrees() || other_action {
                return Err(Failure::difference(format!(
                    "{}, {}: largest error {:.1e} (limit {TOLERANCE:.0e}), {} other choices, {} inputs that only \
                     one answers",
                    engine.name,
                    family.name,
                    family.max_rel_error,
                    family.action_mismatches,
                    family.refusals_differ
                )));
            }
        }
    }
    Ok(())
}
