//! The model card of a bundle.

use sortie_envs::{Metric, Spec};

use super::MethodRun;
use crate::evaluate::Evaluation;
use crate::export::{DeployedNetworks, Words};
use crate::run::RunDescription;

/// A measured allocation, for the card.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The scenario set that it was measured on; the bundle serves its sizes.
    pub set: String,
    /// Who allocated.
    pub allocation: String,
    /// How the team did.
    pub evaluation: Evaluation,
}

pub(super) fn card(
    run: &MethodRun<'_>,
    measured: &[Measured],
    networks: &DeployedNetworks<'_>,
) -> String {
    let RunDescription { seed, version, config, .. } = run.description;
    let Words { mut agents, allocator, figures, mut departures, limits } = run.method.words();
    if agents.is_empty() {
        networks.about().clone_into(&mut agents);
    }
    let runs_options = matches!(networks, DeployedNetworks::Options { .. });
    let episodes = if runs_options { "Episodes" } else { "Greedy episodes" };
    let mut card = format!(
        "# A team for {}\n\n\
         {agents} Trained by\n\
         `sortie train {}`, seed {seed}, Sortie {version}; `train.toml` repeats the run.\n\n\
         {allocator}\
         ## How well it does\n\n\
         {episodes} that training never saw. {figures}The interval is that of the episodes, not of training again.\n\n",
        config.environment, config.method,
    );
    let is_allocated = run.method.subtasks().is_some();
    card += &measured_table(measured, is_allocated.then(|| run.environment.spec()));
    if !config.run.from.is_empty() {
        card += &format!("\nIt began with the networks of the run `{}`.\n", config.run.from);
    }
    if let Some(last) = run.curve.last() {
        card += &format!(
            "\nTraining took {} environment steps, {:.0} seconds of processor time and {:.0} seconds.\n",
            last.env_steps, last.cpu_s, last.wall_s
        );
    }
    card += &format!(
        "\nMatrix products were computed with `{}`: `--set run.products={0}` repeats the run byte for byte.\n",
        config.run.products
    );
    if let DeployedNetworks::Options { options, .. } = networks {
        card += &format!(
            "\n{:.0} % of its actions are drawn, and {:.0} % of its goals, from the seed {} that `bundle.toml` states: the \
             same episode is the same again.\n",
            100.0 * options.action_chance,
            100.0 * options.goal_chance,
            options.seed
        );
    }
    let skips =
        matches!(networks, DeployedNetworks::Attention { network, .. } if network.skip.is_some());
    if departures.is_empty() && skips {
        departures += "- An agent's own embedding reaches the layer before the head past the attention (`network.skip`).\n";
    }
    for (title, text) in
        [("Where the training departs from the dissertation", departures), ("Limits", limits)]
    {
        if !text.is_empty() {
            card += &format!("\n## {title}\n\n{text}");
        }
    }
    card
}

/// A column of the card's table: its name, and what stands in it.
type Column<'a> = (&'a str, Box<dyn Fn(&Measured) -> String + 'a>);

fn of_metric(metric: &Metric) -> Column<'_> {
    let value = |it: &Measured| it.evaluation.metrics.get(&*metric.name).copied();
    (metric.about, Box::new(move |it| format!("{:.3}", value(it).unwrap_or(f64::NAN))))
}

/// The card's table of measured episodes, a row for each set and allocation; who allocated, and the environment's own
/// metrics, stand in it where agents are allocated in such an environment.
pub fn measured_table(measured: &[Measured], allocated_in: Option<&Spec>) -> String {
    let success = |Evaluation { success, success_ci95: [low, high], .. }: &Evaluation| {
        format!("{success:.3} ({low:.3} to {high:.3})")
    };
    let set = if allocated_in.is_some() { "scenarios" } else { "starts" };
    let mut columns: Vec<Column<'_>> = vec![
        (set, Box::new(|it| format!("`{}`", it.set))),
        ("episodes", Box::new(|it| it.evaluation.episodes.to_string())),
        ("success (95 % interval)", Box::new(move |it| success(&it.evaluation))),
        ("time-outs", Box::new(|it| format!("{:.3}", it.evaluation.timeouts))),
        ("return", Box::new(|it| format!("{:.2}", it.evaluation.return_mean))),
    ];
    if let Some(spec) = allocated_in {
        let metrics = spec.metrics.iter().filter(|metric| metric.is_reported);
        columns.splice(3..3, metrics.map(of_metric));
        columns.insert(1, ("allocation", Box::new(|it| it.allocation.clone())));
    } else {
        columns.push(("steps", Box::new(|it| format!("{:.2}", it.evaluation.length_mean))));
    }
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    let rule = vec!["---"; columns.len()].join(" | ");
    let mut table = format!("| {} |\n| {rule} |\n", names.join(" | "));
    for one in measured {
        let cells: Vec<String> = columns.iter().map(|(_, cell)| cell(one)).collect();
        table += &format!("| {} |\n", cells.join(" | "));
    }
    table
}
