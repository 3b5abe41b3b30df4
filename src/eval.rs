//! `sortie eval`: how good is a team, over fresh greedy episodes?

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use sortie_learn::evaluate::{
    Allocate, Evaluation, EvaluationPlan, Planner, PlannerReport, PolicyTeam, ScriptedActors, Team,
    evaluate, evaluate_watched,
};

use crate::arguments::{AllocatorChoice, Common};
use crate::compile::PlanProfile;
use crate::environment::{self, ScenarioSetName};
use crate::episodes::EpisodeWriter;
use crate::failure::{Exit, Failure, Outcome};
use crate::observations::RecordingPolicy;
use crate::output::{Table, print_json, say};
use crate::policy::{Backend, DeployedPolicy};
use crate::proposals::ProposalArguments;
use crate::subject::Subject;
use crate::subject_allocator;

/// Evaluate a team over fresh greedy episodes
///
/// SUBJECT is a bundle, the folder of a training run, or `scripted` for the environment's own
/// hand-written low level. Episodes are drawn from the seed and never seen in training; the same seed
/// gives the same episodes whoever plays them.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie eval models/save-the-city --episodes 2000
  sortie eval models/save-the-city --allocator runs/other
  sortie eval models/save-the-city --plan 24
  sortie eval models/save-the-city --profile int8
  sortie eval models/save-the-city --episodes 100 --dump observations.bin
  sortie eval scripted --env save-the-city/2-8a_2-8b --allocation heuristic")]
pub(crate) struct EvalArguments {
    /// A bundle, a training run, or `scripted`
    subject: String,
    /// Environment and scenario set; default: those of the subject
    #[arg(long, value_name = "ENV[/SET]")]
    env: Option<String>,
    /// Episodes to play
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Who assigns agents to subtasks [default: learned where the subject has it, else coordinated]
    #[arg(long, value_enum)]
    allocation: Option<AllocatorChoice>,
    #[command(flatten)]
    proposals: ProposalArguments,
    /// Bundle or training run whose learned allocator takes the place of the subject's
    #[arg(long, value_name = "BUNDLE|RUN", conflicts_with = "allocation")]
    allocator: Option<String>,
    /// Yardstick: look ahead with the exact simulator and try up to K changed allocations a decision
    ///
    /// The allocator's choice is played to the end in a copy of the world; where that does not solve
    /// the episode, K randomly changed allocations are played as well and the best is taken. It shows
    /// what allocation could still gain with this team; it is not a learned policy.
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u16).range(1..))]
    plan: Option<u16>,
    /// Record every episode into this folder, for `sortie replay`
    #[arg(long, value_name = "DIR")]
    episodes_out: Option<PathBuf>,
    /// Record what the agents of a bundle see into this file, for `sortie bench decision` and `sortie compile`
    #[arg(long, value_name = "FILE", conflicts_with = "plan")]
    dump: Option<PathBuf>,
    /// What executes a bundle's network
    #[arg(long, value_enum, default_value_t = Backend::Plan)]
    backend: Backend,
    /// How a bundle's plan computes
    #[arg(long, value_enum, default_value_t = PlanProfile::Exact, conflicts_with = "backend")]
    profile: PlanProfile,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report<'a> {
    env: &'a str,
    subject: &'a str,
    allocation: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    allocator: Option<&'a str>,
    seed: u64,
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    #[serde(skip_serializing_if = "Option::is_none")]
    planner: Option<PlannerReport>,
}

/// What was measured, and what the planner did if there was one.
type Played = (Evaluation, Option<PlannerReport>);

pub(crate) fn run(arguments: &EvalArguments) -> Outcome {
    let subject = Subject::find(&arguments.subject)?;
    if arguments.dump.is_some() && !matches!(subject, Subject::Bundle(_)) {
        let message = "--dump records what the agents of a bundle see; name a bundle's folder";
        return Err(Failure::new(Exit::Usage, message));
    }
    let set = environment::scenario_set(arguments.env.as_deref(), &subject)?;
    let plan = EvaluationPlan::new(set.set(), arguments.episodes as usize, arguments.common.seed)?;
    let other = arguments.allocator.as_deref().map(Subject::find).transpose()?;
    let asked = other.as_ref().map(|_| AllocatorChoice::Learned).or(arguments.allocation);
    let owner = other.as_ref().unwrap_or(&subject);
    let name = arguments.allocator.as_ref().unwrap_or(&arguments.subject);
    let draws = (arguments.proposals, arguments.common.seed);
    let (allocation, mut allocator) =
        subject_allocator::open_for(&subject, asked, owner, name, arguments.backend, draws)?;
    if let (Subject::Bundle(bundle), true) = (owner, allocator.is_deployed()) {
        environment::check_fits(bundle, &plan.set)?;
    }
    let mut allocator = allocator.allocator()?;
    let mut play =
        |team: &mut dyn Team| play(&plan, team, allocator.as_mut(), arguments, allocation);
    let (evaluation, planner) = match &subject {
        Subject::Scripted => play(&mut ScriptedActors::new(arguments.common.seed))?,
        Subject::Run(run) => play(&mut run.team())?,
        Subject::Bundle(bundle) => {
            environment::check_fits(bundle, &plan.set)?;
            let profile = arguments.profile.profile();
            let mut policy = DeployedPolicy::open_as(bundle, arguments.backend, profile)?;
            let mut policy = policy.policy()?;
            match &arguments.dump {
                None => play(&mut PolicyTeam::new(policy.as_mut()))?,
                Some(file) => {
                    let mut recorder = RecordingPolicy::new(policy.as_mut(), bundle);
                    let played = play(&mut PolicyTeam::new(&mut recorder))?;
                    recorder.write(file)?;
                    played
                }
            }
        }
    };
    if arguments.common.json {
        print_json(&Report {
            env: &set.to_string(),
            subject: &arguments.subject,
            allocation,
            allocator: arguments.allocator.as_deref(),
            seed: arguments.common.seed,
            evaluation: &evaluation,
            planner,
        });
    } else {
        print(&set, arguments, allocation, &evaluation, planner);
    }
    Ok(())
}

fn play(
    plan: &EvaluationPlan,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
    arguments: &EvalArguments,
    allocation: &str,
) -> Result<Played, Failure> {
    let Some(candidates) = arguments.plan else {
        return Ok((record(plan, team, allocator, arguments, allocation)?, None));
    };
    let mut planner = Planner::new(plan, allocator, candidates.into())?;
    let allocation = format!("planned from {allocation}");
    let evaluation = record(plan, team, &mut planner, arguments, &allocation)?;
    Ok((evaluation, Some(planner.report())))
}

/// Plays, and writes the episodes to files where that is wanted.
fn record(
    plan: &EvaluationPlan,
    team: &mut dyn Team,
    allocator: &mut dyn Allocate,
    arguments: &EvalArguments,
    allocation: &str,
) -> Result<Evaluation, Failure> {
    let Some(folder) = &arguments.episodes_out else {
        return Ok(evaluate(plan, team, allocator)?);
    };
    let labels = (arguments.subject.as_str(), allocation);
    let mut writer = EpisodeWriter::new(folder, labels, arguments.common.seed)?;
    Ok(evaluate_watched(plan, team, allocator, &mut writer)?)
}

fn print(
    set: &ScenarioSetName,
    arguments: &EvalArguments,
    allocation: &str,
    evaluation: &Evaluation,
    planner: Option<PlannerReport>,
) {
    let [low, high] = evaluation.success_ci95;
    say!(
        "{set}: {}{}{}, {} episodes",
        arguments.subject,
        if allocation == "none" {
            " without allocation".to_owned()
        } else {
            format!(" under {allocation} allocation")
        },
        arguments.allocator.as_ref().map_or(String::new(), |name| format!(" of {name}")),
        evaluation.episodes
    );
    if let Some(PlannerReport { candidates, decisions, changed, .. }) = planner {
        say!(
            "planned with the exact simulator, {candidates} candidates: no learned policy, but a yardstick \
             ({changed} of {decisions} decisions changed)"
        );
    }
    let mut table = Table::new(&["figure", "value"]);
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    row("success", format!("{:.3} ({low:.3} to {high:.3})", evaluation.success));
    row("no building burned", format!("{:.3}", evaluation.none_burned));
    row("time-outs", format!("{:.3}", evaluation.timeouts));
    row("return", format!("{:.2} (sd {:.2})", evaluation.return_mean, evaluation.return_sd));
    row("steps", format!("{:.1}", evaluation.length_mean));
    table.print();
    say!();
    let mut causes = Table::new(&["cause of failure", "episodes", "share"]);
    for (cause, count) in &evaluation.failures {
        let share = *count as f64 / evaluation.episodes.max(1) as f64;
        causes.row([cause.clone(), count.to_string(), format!("{share:.3}")]);
    }
    causes.print();
    say!();
    let mut teams = Table::new(&["team", "episodes", "success"]);
    for (team, success) in &evaluation.by_team {
        let share = success.solved as f64 / success.episodes.max(1) as f64;
        teams.row([team.clone(), success.episodes.to_string(), format!("{share:.3}")]);
    }
    teams.print();
}
