//! What was found, for people, and whether it is good enough.

use sortie_cli::failure::{Failure, Outcome};
use sortie_cli::output::{Table, say, tell};
use sortie_plans::{GOLDEN_FAMILY, LEAST_AGREEMENT, MOST_DISTANCE, RECORDED, TOLERANCE};

use super::{Compared, DOUBLE, Report};

pub(super) fn print(report: &Report) {
    let first = if report.is_policy { "  output" } else { "  family" };
    for engine in &report.engines {
        say!("{}", engine.name);
        let mut table = Table::new(&[
            first,
            "cases",
            "error",
            "rounding",
            "other",
            "refused",
            "one",
            "swallowed",
        ]);
        for family in &engine.families {
            let note = if family.judged { "" } else { "*" };
            table.row([
                format!("  {}{note}", family.name),
                family.inputs.to_string(),
                format!("{:.1e}", family.max_rel_error),
                family.max_distance.map_or("-".to_owned(), |distance| format!("{distance:.1}")),
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
    say!(
        "rounding: the largest difference, in what 32 bits make right engines err;\nat most {MOST_DISTANCE}"
    );
    if let Some(engine) = report.engine {
        say!("{engine}");
    }
}

const NOTE: &str = "\
error: the largest relative one; other: another action or allocation
*: shown, not judged
refused: the plan returns an error, and the other engine's numbers are not
finite or no action is available; one: only one of them answered
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

/// What the plan gives counts, beside what was recorded and beside the truth; that another engine alone is off is a remark.
/// Where there is no plan or no truth, all that was compared counts.
pub(super) fn judge<'a>(engines: impl IntoIterator<Item = &'a Compared>) -> Outcome {
    let counts = |engine: &&Compared| {
        let mut beside = [RECORDED, DOUBLE, GOLDEN_FAMILY].into_iter();
        let of_plan = beside.any(|what| engine.name.contains(&format!("plan against {what}")));
        of_plan || engine.name.starts_with("plan in golden")
    };
    let (of_plan, others): (Vec<_>, Vec<_>) = engines.into_iter().partition(counts);
    judge_all(of_plan.iter().copied())?;
    if !of_plan.iter().any(|engine| engine.max_distance.is_some()) {
        return judge_all(others);
    }
    for engine in others {
        if let Err(failure) = judge_all([engine]) {
            tell!("note: {}; the plan is right", failure.message);
        }
    }
    Ok(())
}

/// Another choice within the tolerance is a near tie, but for golden observations, which have none: they are judged by it
/// where no truth tells how near.
fn judge_all<'a>(engines: impl IntoIterator<Item = &'a Compared>) -> Outcome {
    for engine in engines {
        for family in &engine.families {
            let is_strict = family.name == GOLDEN_FAMILY && family.max_distance.is_none();
            let other_action = family.action_mismatches > 0 && is_strict;
            if !family.agrees() || other_action {
                let how_far = match family.max_distance {
                    Some(distance) => format!(
                        "{distance:.0} times what rounding accounts for (limit {MOST_DISTANCE}), largest error {:.1e}",
                        family.max_rel_error
                    ),
                    None => {
                        let error = family.max_rel_error;
                        format!("largest error {error:.1e} (limit {TOLERANCE:.0e})")
                    }
                };
                return Err(Failure::difference(format!(
                    "{}, {}: {how_far}, {} other choices, {} inputs that only one answers",
                    engine.name, family.name, family.action_mismatches, family.refusals_differ
                )));
            }
        }
    }
    Ok(())
}
