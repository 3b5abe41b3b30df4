//! `sortie eval`: how good is a team, over fresh greedy episodes?

mod attention;
mod method;

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;
use serde::Serialize;
use sortie_envs::{Spec, Split};
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::Onlooker;
use sortie_methods::alma::evaluate::{EvaluationPlan, Planner, PlannerReport, evaluate_watched};
use sortie_methods::alma::teams::{Allocate, PolicyTeam, ScriptedActors, Team};

use self::method::{flat_bundle, play_bundle, play_method, play_script};
use crate::allocation::AllocatorChoice;
use crate::allocator::ProposalArguments;
use crate::environment::{self, ScenarioSetName};
use crate::failure::{Exit, Failure, Outcome};
use crate::files::{EpisodeWriter, Kind, RecordingPolicy, try_output};
use crate::methods::LearnedMethod;
use crate::output::{Common, Table, plural, print_json, say};
use crate::policy::{Backend, DeployedPolicy, PlanProfile};
use crate::seeds::SeedRange;
use crate::subject::{self, Subject};
use crate::terminal::{self, CountedEpisodes};

/// Evaluate a team over fresh greedy episodes
///
/// SUBJECT is a bundle, the folder of a training run, or `scripted` for the environment's own
/// hand-written low level. Episodes are drawn from the seed and never seen in training; the same seed
/// gives the same episodes whoever plays them.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie eval models/save-the-city --episodes 2000
  sortie eval models/save-the-city --episodes 2000 --seeds 1001..1016
  sortie eval models/save-the-city --allocator runs/other
  sortie eval models/save-the-city --plan 24
  sortie eval models/save-the-city --profile int8
  sortie eval models/save-the-city --episodes 100 --dump observations.bin
  sortie eval scripted --env save-the-city/2-8a_2-8b --allocation heuristic")]
pub(crate) struct EvalArguments {
    /// A bundle, a training run, or `scripted`
    subject: PathBuf,
    /// Environment and scenario set; default: those of the subject
    #[arg(long, value_name = "ENV[/SET]")]
    env: Option<String>,
    /// Episodes to play, with --seeds of each seed
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// The episodes of several seeds, A and B included, taken together
    #[arg(long, value_name = "A..B", conflicts_with_all = ["seed", "plan", "episodes_out", "dump"])]
    seeds: Option<SeedRange>,
    /// Who assigns agents to subtasks [default: learned where the subject has it, else coordinated]
    #[arg(long, value_enum)]
    allocation: Option<AllocatorChoice>,
    #[command(flatten)]
    proposals: ProposalArguments,
    /// Bundle or training run whose learned allocator takes the place of the subject's
    #[arg(long, value_name = "BUNDLE|RUN", conflicts_with = "allocation")]
    allocator: Option<PathBuf>,
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
    /// Also tell whom the critic of a run looks at, agent by agent, means over all steps: of `maac`
    #[arg(long)]
    attention: bool,
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
    /// Absent where there are several.
    #[serde(skip_serializing_if = "Option::is_none")]
    seed: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    seeds: Option<&'a BySeed>,
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    #[serde(skip_serializing_if = "Option::is_none")]
    planner: Option<PlannerReport>,
}

/// How far seeds lie apart.
#[derive(Serialize)]
pub(super) struct BySeed {
    success: BTreeMap<u64, f64>,
    success_sd: f64,
    returns: BTreeMap<u64, f64>,
    returns_sd: f64,
}

/// What was measured, who allocated, and what the planner did if there was one.
struct Played {
    evaluation: Evaluation,
    allocation: &'static str,
    planner: Option<PlannerReport>,
}

/// What plays, whatever the seed.
struct Match<'a> {
    arguments: &'a EvalArguments,
    subject: Subject,
    /// Whose allocator takes the place of the subject's.
    other: Option<Subject>,
    set: ScenarioSetName,
    bar: ProgressBar,
}

pub(crate) fn run(arguments: &EvalArguments) -> Outcome {
    arguments.backend.prepare()?;
    if let Some(learned) = LearnedMethod::find(&arguments.subject)? {
        return play_method(arguments, &learned);
    }
    if arguments.attention {
        let reason = "`--attention` tells of critics, which are not deployed; name a run of `maac`";
        return Err(Failure::new(Exit::Usage, reason));
    }
    if let Some(bundle) = flat_bundle(&arguments.subject)? {
        return play_bundle(arguments, &bundle);
    }
    let subject = Subject::find(&arguments.subject)?;
    check(arguments, &subject)?;
    if let Some(file) = &arguments.dump {
        try_output(file, Kind::Observations)?;
    }
    let set = subject.scenario_set(arguments.env.as_deref())?;
    if matches!(subject, Subject::Scripted) && !set.has_subtasks()? {
        return play_script(arguments, &set);
    }
    set.check_subtasks()?;
    let other = arguments.allocator.as_deref().map(Subject::find).transpose()?;
    let seeds = arguments.seeds.unwrap_or(SeedRange::only(arguments.common.seed));
    let episodes = u64::from(arguments.episodes).saturating_mul(seeds.iter().count() as u64);
    let bar = terminal::bar(arguments.common, episodes, "episodes");
    let playing = Match { arguments, subject, other, set, bar };
    let played = seeds.iter().map(|seed| Ok((seed, playing.play(seed)?)));
    let mut played: Vec<(u64, Played)> = played.collect::<Result<_, Failure>>()?;
    playing.bar.finish_and_clear();
    let by_seed = arguments
        .seeds
        .map(|_| BySeed::of(played.iter().map(|(seed, one)| (*seed, &one.evaluation))));
    let parts: Vec<Evaluation> = played.iter().map(|(_, one)| one.evaluation.clone()).collect();
    let Some((_, mut last)) = played.pop() else { return Ok(()) };
    if by_seed.is_some() {
        last.evaluation = Evaluation::pooled(&parts);
    }
    if arguments.common.json {
        print_json(&Report {
            env: &playing.set.to_string(),
            subject: &arguments.subject.to_string_lossy(),
            allocation: last.allocation,
            allocator: arguments.allocator.as_ref().map(|path| path.to_string_lossy()).as_deref(),
            seed: by_seed.is_none().then_some(arguments.common.seed),
            seeds: by_seed.as_ref(),
            evaluation: &last.evaluation,
            planner: last.planner,
        });
    } else {
        let environment = playing.set.open(Split::Test)?;
        print(&playing, &last, environment.spec(), by_seed.as_ref());
    }
    Ok(())
}

/// Refuses flags that would do nothing.
fn check(arguments: &EvalArguments, subject: &Subject) -> Outcome {
    if matches!(subject, Subject::Bundle(_)) {
        return Ok(());
    }
    let is_tract = arguments.backend == Backend::Tract && arguments.allocator.is_none();
    let refused = [
        ("--dump", arguments.dump.is_some(), "records what the agents of a bundle see"),
        ("--backend tract", is_tract, "executes the networks of a bundle"),
        (
            "--profile",
            arguments.profile != PlanProfile::Exact,
            "says how the plan of a bundle computes",
        ),
    ];
    match refused.into_iter().find(|(_, is_given, _)| *is_given) {
        None => Ok(()),
        Some((flag, _, what)) => {
            Err(Failure::new(Exit::Usage, format!("`{flag}` {what}; name a bundle's folder")))
        }
    }
}

impl BySeed {
    fn of<'a>(evaluations: impl Iterator<Item = (u64, &'a Evaluation)>) -> Self {
        let figures =
            |(seed, one): (u64, &Evaluation)| ((seed, one.success), (seed, one.return_mean));
        let (success, returns): (BTreeMap<_, _>, BTreeMap<_, _>) = evaluations.map(figures).unzip();
        Self { success_sd: sd(&success), returns_sd: sd(&returns), success, returns }
    }
}

/// How far seeds lie apart.
fn sd(by_seed: &BTreeMap<u64, f64>) -> f64 {
    let mean = by_seed.values().sum::<f64>() / by_seed.len().max(1) as f64;
    let squares: f64 = by_seed.values().map(|value| (value - mean).powi(2)).sum();
    (squares / by_seed.len().saturating_sub(1).max(1) as f64).sqrt()
}

impl Match<'_> {
    /// Plays the episodes of one seed.
    fn play(&self, seed: u64) -> Result<Played, Failure> {
        let Self { arguments, subject, other, set, .. } = self;
        let environment = set.open(Split::Test)?;
        let plan = EvaluationPlan::new(&*environment, arguments.episodes as usize, seed);
        let asked = other.as_ref().map(|_| AllocatorChoice::Learned).or(arguments.allocation);
        let owner = other.as_ref().unwrap_or(subject);
        let name = arguments.allocator.as_ref().unwrap_or(&arguments.subject).to_string_lossy();
        let draws = (arguments.proposals, seed);
        let (allocation, mut allocator) = subject::open_for(
            (subject, set.entry()),
            asked,
            owner,
            &name,
            arguments.backend,
            draws,
        )?;
        if let (Subject::Bundle(bundle), true) = (owner, allocator.is_deployed()) {
            environment::check_fits(bundle, set)?;
        }
        let mut allocator = allocator.allocator()?;
        let mut play = |team: &mut dyn Team| self.watch(&plan, team, &mut *allocator, allocation);
        match subject {
            Subject::Scripted => play(&mut ScriptedActors::new(seed)),
            Subject::Run(run) => play(&mut run.team()),
            Subject::Bundle(bundle) => {
                environment::check_fits(bundle, set)?;
                let profile = arguments.profile.profile();
                let mut policy = DeployedPolicy::open_as(bundle, arguments.backend, profile)?;
                let mut policy = policy.policy()?;
                let Some(file) = &arguments.dump else {
                    return play(&mut PolicyTeam::new(policy.as_mut()));
                };
                let mut recorder = RecordingPolicy::new(policy.as_mut(), bundle);
                let played = play(&mut PolicyTeam::new(&mut recorder))?;
                recorder.write(file)?;
                Ok(played)
            }
        }
    }

    /// Has a planner look ahead where that is wanted.
    fn watch(
        &self,
        plan: &EvaluationPlan<'_>,
        team: &mut dyn Team,
        allocator: &mut dyn Allocate,
        allocation: &'static str,
    ) -> Result<Played, Failure> {
        let Some(candidates) = self.arguments.plan else {
            let evaluation = self.record(plan, team, allocator, allocation)?;
            return Ok(Played { evaluation, allocation, planner: None });
        };
        let mut planner = Planner::new(plan, allocator, candidates.into());
        let label = format!("planned from {allocation}");
        let evaluation = self.record(plan, team, &mut planner, &label)?;
        Ok(Played { evaluation, allocation, planner: Some(planner.report()) })
    }

    /// Plays, and writes the episodes to files where that is wanted.
    fn record(
        &self,
        plan: &EvaluationPlan<'_>,
        team: &mut dyn Team,
        allocator: &mut dyn Allocate,
        allocation: &str,
    ) -> Result<Evaluation, Failure> {
        let mut counted = |next: &mut dyn Onlooker| {
            evaluate_watched(plan, team, allocator, &mut CountedEpisodes { bar: &self.bar, next })
        };
        let Some(folder) = &self.arguments.episodes_out else {
            return Ok(counted(&mut ())?);
        };
        let subject = self.arguments.subject.to_string_lossy();
        let mut writer =
            EpisodeWriter::new(folder, self.set.entry(), (&subject, allocation), plan.seed)?;
        Ok(counted(&mut writer)?)
    }
}

fn print(playing: &Match<'_>, played: &Played, spec: &Spec, by_seed: Option<&BySeed>) {
    let Match { arguments, set, .. } = playing;
    let Played { evaluation, allocation, planner } = played;
    let under = match *allocation {
        "none" => " without allocation".to_owned(),
        name => format!(" under {name} allocation"),
    };
    let of = arguments.allocator.as_ref().map(|path| format!(" of {}", path.display()));
    say!(
        "{set}: {}{under}{}, {}",
        arguments.subject.display(),
        of.unwrap_or_default(),
        plural(evaluation.episodes, "episode")
    );
    if let Some(PlannerReport { candidates, decisions, changed, .. }) = planner {
        say!(
            "planned with the exact simulator, {candidates} candidates: no learned policy, but a yardstick \
             ({changed} of {decisions} decisions changed)"
        );
    }
    print_tables(evaluation, spec, by_seed);
}

fn print_tables(evaluation: &Evaluation, spec: &Spec, by_seed: Option<&BySeed>) {
    let Evaluation { success, success_ci95: [low, high], return_mean, return_sd, .. } = evaluation;
    let mut table = Table::new(&["figure", "value"]);
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    let success = ("success", format!("{success:.3} ({low:.3} to {high:.3})"));
    let returned = ("return", format!("{return_mean:.2} (sd {return_sd:.2})"));
    let (first, by_seed) = match spec.has_success {
        true => (&success, by_seed.map(|by_seed| (&by_seed.success, by_seed.success_sd, 3))),
        false => (&returned, by_seed.map(|by_seed| (&by_seed.returns, by_seed.returns_sd, 2))),
    };
    row(first.0, first.1.clone());
    if let Some((of_seeds, sd, digits)) = by_seed {
        let least = of_seeds.values().copied().fold(f64::INFINITY, f64::min);
        let most = of_seeds.values().copied().fold(f64::NEG_INFINITY, f64::max);
        let name = format!("of {}", plural(of_seeds.len(), "seed"));
        row(&name, format!("sd {sd:.digits$} ({least:.digits$} to {most:.digits$})"));
    }
    for metric in spec.metrics {
        if let Some(value) = evaluation.metrics.get(metric.name) {
            row(metric.about, format!("{value:.3}"));
        }
    }
    if spec.has_success {
        row("time-outs", format!("{:.3}", evaluation.timeouts));
        row(returned.0, returned.1);
    }
    row("steps", format!("{:.1}", evaluation.length_mean));
    table.print();
    if !evaluation.failures.is_empty() {
        say!();
        print_failures(evaluation);
    }
    if spec.has_success {
        say!();
        print_teams(evaluation);
    }
}

fn print_teams(evaluation: &Evaluation) {
    let mut teams = Table::new(&["team", "episodes", "success"]);
    for (team, success) in &evaluation.by_team {
        let share = success.solved as f64 / success.episodes.max(1) as f64;
        teams.row([team.clone(), success.episodes.to_string(), format!("{share:.3}")]);
    }
    teams.print();
}

fn print_failures(evaluation: &Evaluation) {
    let mut causes = Table::new(&["cause of failure", "episodes", "share"]);
    for (cause, count) in &evaluation.failures {
        let share = *count as f64 / evaluation.episodes.max(1) as f64;
        causes.row([cause.clone(), count.to_string(), format!("{share:.3}")]);
    }
    causes.print();
}
