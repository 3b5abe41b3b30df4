//! Bundles: compiled to the same bundle with plans, or to the int8 plan of its agents, judged by what that achieves; and
//! policies of somebody else with int8 weights, judged by how they act.

use std::path::Path;

use serde::Serialize;
use sortie_bundle::{Bundle, GUARDS, Recording, guards_to_toml, hex};
use sortie_cli::allocator::ProposalArguments;
use sortie_cli::deployment::open_bundle;
use sortie_cli::environment::{ScenarioSetName, check_fits};
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::files::{Kind, recording_of, recording_policy, try_output};
use sortie_cli::npz::{self, RecordedInputs};
use sortie_cli::output::{Table, print_json, say};
use sortie_cli::policy::{Backend, DeployedPolicy, PlanProfile};
use sortie_cli::remake::read_observations;
use sortie_cli::subject::Subject;
use sortie_cli::terminal::CountedEpisodes;
use sortie_cli::tools::{compiler, plans, with_plans};
use sortie_cli::{subject, terminal};
use sortie_core::Policy;
use sortie_core::plan::{AlignedBytes, Profile};
use sortie_envs::{Environment, Split};
use sortie_learn::Act;
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play::{PolicyTeam, evaluate_watched};
use sortie_learn::subtasks::{AllocatedTeam, PolicyAgents};
use sortie_plans::{
    AgentPlans, CompileError, CompileOptions, Compiled, LARGEST_DEVIATION, LEAST_AGREEMENT,
    LEAST_OBSERVATIONS, PolicyAgreement, ProofCase, Quantised, QuantisedPolicy, RecordedCase,
    quantise, quantise_policy,
};

use super::{
    CompileArguments, Written, WrittenBundle, guards, print, print_agreement, print_bytes,
    print_operators, refuse, write_plan,
};

/// By how much an int8 plan may succeed less often than the exact plan.
const MARGIN: f64 = 0.01;

/// Episodes that both plans play.
const JUDGED: usize = 2000;

/// Episodes whose observations weights are rounded for, or features are guarded by.
const RECORDED: usize = 100;

/// How an int8 plan of a bundle is judged.
const RULE: &str = "success over 2,000 paired episodes at most 0.01 below that of the exact plan";

/// What the int8 plan and the exact one achieved in the same episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Paired {
    rule: &'static str,
    episodes: usize,
    /// Seed of these episodes; those whose observations weights were rounded for have another.
    seed: u64,
    rounding_seed: u64,
    success_exact: f64,
    success_int8: f64,
}

impl Paired {
    /// Whether the int8 plan succeeds as often as the rule says.
    fn is_enough(&self) -> bool {
        // Shares of whole episodes: what counts is whether there is one more than the margin's.
        self.success_exact - self.success_int8 <= MARGIN + 1.0e-9
    }

    fn judge(&self, force: bool) -> Outcome {
        if self.is_enough() {
            return Ok(());
        }
        let Self { success_exact, success_int8, .. } = self;
        let flaw = format!(
            "the int8 plan's success is {success_int8:.3}, the exact plan's {success_exact:.3}; needed is: {RULE}"
        );
        refuse(&flaw, force)
    }
}

pub(super) fn compile_bundle(arguments: &CompileArguments) -> Outcome {
    let CompileArguments { guards, guard_inputs, observations, npz, profile, .. } = arguments;
    let is_guarded = guards.is_some() || guard_inputs.is_some();
    let refused = [
        ("--observations", observations.is_some() && guard_inputs.is_none()),
        ("--npz", npz.is_some()),
    ];
    if let Some((flag, _)) = refused.into_iter().find(|(_, is_given)| *is_given) {
        let message =
            format!("`{flag}` is for an ONNX file: a bundle's agents play, and are recorded");
        return Err(Failure::new(Exit::Usage, message));
    }
    let flaw = match (guards, guard_inputs) {
        _ if is_guarded && *profile != PlanProfile::Exact => {
            "guards of a team stand in its bundle: `--profile` gives a plan of its agents, which has none"
        }
        (Some(_), Some(_)) => {
            "`--guards FILE` names the ranges of a team's features, `--guard-inputs` takes them from what \
                               is recorded: leave one of them out"
        }
        _ => return written(arguments),
    };
    Err(Failure::new(Exit::Usage, flaw))
}

/// Writes what the profile says.
fn written(arguments: &CompileArguments) -> Outcome {
    match arguments.profile {
        PlanProfile::Exact => ship(arguments),
        PlanProfile::Int8 => compile_int8(arguments),
        PlanProfile::Fused => {
            let message = "bundles ship plans of profile `exact`, and `int8` gives the plan of their agents; compile the \
                           bundle's `agent.onnx` for others";
            Err(Failure::new(Exit::Usage, message))
        }
    }
}

/// Writes a bundle again, with plans, and with the guards that are asked for.
fn ship(arguments: &CompileArguments) -> Outcome {
    let CompileArguments { onnx: folder, output, common, .. } = arguments;
    let bundle = open_bundle(folder)?;
    let mut draft = bundle.draft();
    if let Some(guards) = asked_guards(arguments, bundle)? {
        draft
            .parts
            .insert(GUARDS.to_owned(), guards_to_toml(&guards, &draft.contract).into_bytes());
    }
    let bundle = with_plans(draft, output)?.write(output)?;
    let (bundle, sha256) = (output, hex(bundle.id()));
    if common.json {
        print_json(&WrittenBundle { bundle, sha256 });
    } else {
        say!("{}: {sha256}", bundle.display());
    }
    Ok(())
}

/// The ranges of features that a file names, or of what agents observe in a recording or in episodes that they play.
fn asked_guards(
    arguments: &CompileArguments,
    bundle: Bundle,
) -> Result<Option<Vec<[f32; 2]>>, Failure> {
    let CompileArguments { guards, guard_inputs, observations, common, .. } = arguments;
    let Some(margin) = *guard_inputs else {
        return guards::of_team(guards.as_deref(), bundle.contract());
    };
    let recording = match observations {
        Some(file) => read_observations(file, &bundle)?,
        None => {
            let bar = terminal::bar(*common, RECORDED as u64, "episodes");
            let mut agents = DeployedPolicy::open(&bundle, Backend::Plan)?;
            let playing = Playing::open(bundle)?;
            let recording = playing.recorded(agents.policy()?.as_mut(), common.seed, &bar)?;
            bar.finish_and_clear();
            recording
        }
    };
    guards::seen_by_team(&recording, margin).map(Some)
}

/// Writes the int8 plan of a bundle's agents, if it succeeds as often as the exact one.
fn compile_int8(arguments: &CompileArguments) -> Outcome {
    let CompileArguments { onnx: folder, output, common, .. } = arguments;
    let playing = Playing::open(open_bundle(folder)?)?;
    playing.check_judged()?;
    try_output(output, Kind::Plan)?;
    let bar = terminal::bar(*common, (RECORDED + 2 * JUDGED) as u64, "episodes");
    let bundle = &playing.bundle;
    let mut exact = DeployedPolicy::open(bundle, Backend::Plan)?;
    let mut exact = exact.policy()?;
    let rounding_seed = apart(common.seed);
    let recording = playing.recorded(exact.as_mut(), rounding_seed, &bar)?;
    let within = |error| Failure::from(error).within(folder.display());
    let compile = |profile: Profile, examples: &_| plans().agent(bundle, profile, examples);
    let quantised = quantise(compile, &recording).map_err(within)?;
    let plan = AlignedBytes::copy_of(&quantised.compiled.bytes);
    let int8 = AgentPlans::new(bundle, vec![plan]);
    let mut int8 = DeployedPolicy::of_plans(int8).map_err(within)?;
    let success = |policy: &mut dyn Policy| {
        Ok::<_, Failure>(playing.play(policy, JUDGED, common.seed, &bar)?.success)
    };
    let paired = Paired {
        rule: RULE,
        episodes: JUDGED,
        seed: common.seed,
        rounding_seed,
        success_exact: success(exact.as_mut())?,
        success_int8: success(int8.policy()?.as_mut())?,
    };
    bar.finish_and_clear();
    if !common.json && !common.quiet {
        print_agreement(&quantised);
        let Paired { success_exact, success_int8, .. } = paired;
        say!(
            "success over {JUDGED} paired episodes: {success_int8:.3}, of the exact plan {success_exact:.3}"
        );
    }
    paired.judge(arguments.force)?;
    let Quantised { compiled: Compiled { bytes, report }, exact, agreement } = &quantised;
    write_plan(arguments, bytes)?;
    print(arguments, report, Some((agreement, exact)), Some(&paired));
    Ok(())
}

/// The seed of the episodes that weights are rounded for: never that of the episodes that judge.
fn apart(seed: u64) -> u64 {
    seed.wrapping_add(1)
}

/// A bundle in the environment that it was learned in, under its own allocator.
struct Playing {
    bundle: Bundle,
    subject: Subject,
    set: ScenarioSetName,
    environment: Box<dyn Environment>,
}

impl Playing {
    fn open(bundle: Bundle) -> Result<Self, Failure> {
        let set = ScenarioSetName::parse(&bundle.manifest().contract.environment.name)?;
        check_fits(&bundle, &set)?;
        let environment = set.open(Split::Test)?;
        let subject = Subject::Bundle(Box::new(bundle.clone()));
        Ok(Self { bundle, subject, set, environment })
    }

    /// Checks that plans can be judged by how often episodes are solved.
    fn check_judged(&self) -> Outcome {
        if self.environment.spec().has_success {
            return Ok(());
        }
        let message = format!(
            "an int8 plan of a bundle is judged by success, and episodes of `{}` cannot be solved: compile each of its \
             networks with recorded inputs, `sortie compile FILE.onnx --profile int8 --npz FILE`",
            self.set
        );
        Err(Failure::new(Exit::Usage, message))
    }

    /// What a policy decides on in some episodes.
    fn recorded(
        &self,
        policy: &mut dyn Policy,
        seed: u64,
        bar: &indicatif::ProgressBar,
    ) -> Result<Recording, Failure> {
        let mut recording = recording_of(&self.bundle);
        let mut recorder = recording_policy(policy, &mut recording);
        self.play(&mut recorder, RECORDED, seed, bar)?;
        drop(recorder);
        Ok(recording)
    }

    /// Plays so many episodes of a seed: the same whoever plays them.
    fn play(
        &self,
        policy: &mut dyn Policy,
        episodes: usize,
        seed: u64,
        bar: &indicatif::ProgressBar,
    ) -> Result<Evaluation, Failure> {
        let mut counted = CountedEpisodes { bar, next: &mut () };
        let mut play = |team: &mut dyn Act| {
            evaluate_watched(&*self.environment, team, episodes, seed, &mut counted)
        };
        if !self.subject.has_subtasks() {
            return Ok(play(&mut PolicyTeam::new(policy))?);
        }
        let name = self.bundle.folder().to_string_lossy();
        let draws = (ProposalArguments::default(), seed);
        let team = (&self.subject, self.set.entry());
        let opened = subject::open_for(team, None, &self.subject, &name, Backend::Plan, draws);
        let (_, mut allocator) = opened?;
        let agents = Box::new(PolicyAgents::new(policy));
        let interval = self.subject.interval();
        Ok(play(&mut AllocatedTeam::new(agents, allocator.allocator()?, interval))?)
    }
}

/// Compiles a policy to int8 weights; refuses what acts differently than the f32 plan.
pub(super) fn quantised(
    arguments: &CompileArguments,
    onnx: &[u8],
    options: &CompileOptions,
    file: &Path,
    failed: &dyn Fn(CompileError) -> Failure,
) -> Result<QuantisedPolicy, Failure> {
    let arrays = npz::read(file)?;
    let policy = arguments.policy.options_for(&arguments.onnx)?;
    let facts = compiler().rehearse_policy(onnx, &policy).map_err(failed)?;
    let recorded = RecordedInputs::of(&facts, &arrays)
        .map_err(|reason| Failure::new(Exit::BadData, format!("{}: {reason}", file.display())))?;
    let cases: Vec<RecordedCase<'_>> =
        (0..recorded.count).map(|case| recorded.case(case)).collect();
    let compile =
        |profile| compiler().compile_policy(onnx, &policy, &CompileOptions { profile, ..*options });
    let quantised = quantise_policy(compile, &cases).map_err(failed)?;
    judge(&quantised.agreement, arguments.force)?;
    Ok(quantised)
}

/// Compiles a policy, and proves its plan on what was recorded as well.
pub(super) fn recorded(
    arguments: &CompileArguments,
    onnx: &[u8],
    options: &CompileOptions,
    file: &Path,
    failed: &dyn Fn(CompileError) -> Failure,
) -> Result<(Compiled, Vec<String>), Failure> {
    let arrays = npz::read(file)?;
    let policy = arguments.policy.options_for(&arguments.onnx)?;
    let facts = compiler().rehearse_policy(onnx, &policy).map_err(failed)?;
    let recorded = RecordedInputs::of(&facts, &arrays)
        .map_err(|reason| Failure::new(Exit::BadData, format!("{}: {reason}", file.display())))?;
    let most = (options.inputs / 4).clamp(1, recorded.count);
    let case = |number| ProofCase::from(recorded.case(number * recorded.count / most));
    let cases = (0..most).map(case).collect();
    let of = compiler().compile_recorded_policy(onnx, &policy, options, cases).map_err(failed)?;
    Ok((of.compiled, of.remarks))
}

/// Refuses a plan that acts differently, or of which too little is known.
fn judge(agreement: &PolicyAgreement, force: bool) -> Outcome {
    let observations = agreement.observations;
    if observations < LEAST_OBSERVATIONS {
        return refuse(
            &format!(
                "{observations} observations say too little about an int8 plan, {LEAST_OBSERVATIONS} are needed: \
                 record more"
            ),
            force,
        );
    }
    if agreement.is_enough() {
        return Ok(());
    }
    let flaw = format!(
        "the int8 plan takes the same action on {:.3} % of the observations, {:.1} % are needed; its continuous \
         actions differ by {:.3} of what they vary by, {LARGEST_DEVIATION} is allowed",
        100.0 * agreement.share(),
        100.0 * LEAST_AGREEMENT,
        agreement.largest_deviation()
    );
    refuse(&flaw, force)
}

pub(super) fn print_policy(arguments: &CompileArguments, quantised: &QuantisedPolicy) {
    let QuantisedPolicy { compiled, exact, agreement } = quantised;
    let (plan, report) = (arguments.output.as_path(), &compiled.compiled.report);
    if arguments.common.json {
        let (agreement, exact) = (Some(agreement), Some(exact));
        print_json(&Written { plan, report, agreement, paired: None, exact });
        return;
    }
    let mut table = Table::new(&["output", "same action", "largest error / deviation"]);
    for output in &agreement.outputs {
        let same = output.equal_actions.map(|equal| {
            format!("{:.3} %", 100.0 * equal as f64 / agreement.observations.max(1) as f64)
        });
        let deviation = format!("{:.4}", output.largest_deviation);
        table.row([output.name.clone(), same.unwrap_or_default(), deviation]);
    }
    say!("on {} recorded observations, beside the f32 plan", agreement.observations);
    table.print();
    say!();
    print_bytes(report, exact);
    say!();
    print_operators(report);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paired(success_exact: f64, success_int8: f64) -> Paired {
        let rule = RULE;
        Paired { rule, episodes: JUDGED, seed: 1, rounding_seed: 2, success_exact, success_int8 }
    }

    #[test]
    fn a_plan_that_succeeds_less_often_than_the_margin_allows_is_refused() {
        // 20 episodes of 2,000 are 0.01, and 21 are more.
        let solved = |episodes: u32| f64::from(episodes) / JUDGED as f64;
        for (int8, is_enough) in
            [(1780, true), (1760, true), (1759, false), (1900, true), (0, false)]
        {
            let paired = paired(solved(1780), solved(int8));
            assert_eq!(paired.is_enough(), is_enough, "{int8}");
            assert_eq!(paired.judge(false).is_ok(), is_enough, "{int8}");
            assert!(paired.judge(true).is_ok());
        }
        let refused = paired(0.9, 0.85).judge(false).unwrap_err().message;
        for part in ["0.850", "0.900", RULE, "--force"] {
            assert!(refused.contains(part), "{refused}");
        }
    }

    #[test]
    fn the_rule_is_what_is_judged() {
        assert!(RULE.contains("2,000") && JUDGED == 2000 && RULE.contains(&MARGIN.to_string()));
    }

    #[test]
    fn episodes_that_judge_are_none_that_weights_were_rounded_for() {
        for seed in [0, 1, 7, u64::MAX] {
            assert_ne!(apart(seed), seed);
        }
    }
}
