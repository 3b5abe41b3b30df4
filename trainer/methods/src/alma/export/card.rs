//! The model card: what a team is, how well it does, and how it was trained.

use std::fmt::Write as _;

use sortie_learn::draft::Measured;

use super::learned::LearnedAllocator;
use crate::alma::config::Config;
use crate::alma::run::{Run, RunAllocator};
use sortie_learn::run::RunDescription;

/// The model card.
pub(super) fn card(
    run: &Run,
    allocator: Option<LearnedAllocator<'_>>,
    measured: &[Measured],
) -> String {
    let RunDescription { version, seed, config, .. } = &run.description;
    let mut card = format!(
        "# A team for {}\n\n\
         Every agent runs the same masked-attention utility network (dissertation section 7.3): it sees the\n\
         entities of its own subtask, its team mates and one building, and nothing else. Trained by\n\
         `sortie train {}`, seed {}, Sortie {}; `train.toml` repeats the run.\n\n",
        config.environment, config.method, seed, version,
    );
    if let Some(LearnedAllocator { team_max, .. }) = allocator {
        let _ = writeln!(
            card,
            "The allocator values every team at every open building by a network of the same kind and takes the\n\
             best allocation; a team has at most {team_max} agents.\n"
        );
    }
    if let Some(RunAllocator::Proposals { .. }) = &run.allocator {
        card += "The allocator is a policy that proposes allocations, and a critic that values them and takes the best\n\
                 (dissertation section 7.2).\n\n";
    }
    card += "## How well it does\n\nGreedy episodes that training never saw. *Success*: all buildings are complete at the end. *No building burned* is what\n\
             the dissertation calls success. The interval is that of the episodes, not of training again.\n\n";
    card += "| scenarios | allocation | episodes | success (95 % interval) | no building burned | time-outs | return |\n";
    card += "| --- | --- | --- | --- | --- | --- | --- |\n";
    for Measured { set, allocation, evaluation } in measured {
        let [low, high] = evaluation.success_ci95;
        // Writing to a string cannot fail.
        let _ = writeln!(
            card,
            "| `{set}` | {allocation} | {} | {:.3} ({low:.3} to {high:.3}) | {:.3} | {:.3} | {:.2} |",
            evaluation.episodes,
            evaluation.success,
            evaluation.metrics.get("none_burned").copied().unwrap_or(f64::NAN),
            evaluation.timeouts,
            evaluation.return_mean,
        );
    }
    if !config.run.from.is_empty() {
        let _ = writeln!(card, "\nIt began with the networks of the run `{}`.", config.run.from);
    }
    if let Some(last) = run.curve.last() {
        let _ = writeln!(
            card,
            "\nTraining took {} environment steps, {:.0} seconds of processor time and {:.0} seconds.",
            last.env_steps, last.cpu_s, last.wall_s
        );
    }
    let _ = writeln!(
        card,
        "\nMatrix products were computed with `{}`: `--set run.products={0}` repeats the run byte for byte.",
        config.run.products
    );
    card += &departures(run);
    card += "\n## Limits\n\nIt serves teams and cities up to the largest of these scenarios; `bundle.toml` has the numbers.\n\
             Agents that do not share a subtask do not see each other and can block each other's way.\n";
    card
}

/// Whose own embedding reaches the layers behind the attention directly.
fn skips(run: &Run) -> String {
    let allocator = match &run.allocator {
        Some(RunAllocator::TeamValue(network)) => network.shape().skip,
        Some(RunAllocator::Proposals { .. }) | None => false,
    };
    let who = match (run.network.shape().skip, allocator) {
        (true, true) => "agents and of the allocator",
        (true, false) => "agents",
        (false, true) => "allocator",
        (false, false) => return String::new(),
    };
    format!(
        "- The own embedding skips the attention in the networks of the {who}: what the attention gives is\n  \
         `relu(W o + b + V x)` with the own embedding x, published without `V x`.\n"
    )
}

/// What is not in the dissertation.
fn departures(run: &Run) -> String {
    let mut text = "\n## Where the training departs from the dissertation\n\n".to_owned();
    let skips = skips(run);
    text += &skips;
    let config = match &run.config {
        Config::Records(config) => config,
        Config::Windows(_) => {
            text += if skips.is_empty() { "- Nowhere but in" } else { "- In" };
            text += " the sampled windows: none learns a step from one episode to the next.\n";
            return text;
        }
    };
    text += &format!(
        "- Utilities of a subtask's team are summed (VDN); there is no mixing network.\n\
         - It learns from records of one step and one subtask, with {}-step returns and discount {}.\n\
         - Adam with averaged weights; embedding width {}.\n",
        config.returns.steps, config.returns.discount, config.network.width,
    );
    if config.returns.shaping != 0.0 {
        text += &format!(
            "- Potential shaping of {} per cell between an agent and its building, which leaves the best policy\n  \
             as it is.\n",
            config.returns.shaping
        );
    }
    if config.replay.symmetries {
        text += "- Sampled records are turned and mirrored at random.\n";
    }
    text
}
