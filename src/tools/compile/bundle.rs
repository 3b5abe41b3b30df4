//! Bundles: compiled to the same bundle with plans, or to the int8 plan of its agents, judged by what that achieves.

use serde::Serialize;
use sortie_bundle::{Bundle, SubtaskConditioning, hex};
use sortie_core::Policy;
use sortie_core::plan::{AlignedBytes, Profile};
use sortie_envs::{Environment, Split};
use sortie_learn::evaluate::Evaluation;
use sortie_learn::play;
use sortie_methods::alma::evaluate::{EvaluationPlan, evaluate_watched};
use sortie_methods::alma::teams::PolicyTeam;
use sortie_plans::{AgentPlans, Compiled, Quantised, quantise};

use super::{CompileArguments, WrittenBundle, print, print_agreement, refuse, write_plan};
use sortie_cli::compiler::{plans, with_plans};
use sortie_cli::deployment::open_bundle;
use sortie_cli::environment::{ScenarioSetName, check_fits};
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::files::{Kind, try_output};
use sortie_cli::observations::RecordingPolicy;
use sortie_cli::output::{print_json, say};
use sortie_cli::policy::{Backend, DeployedPolicy, PlanProfile};
use sortie_cli::progress::{self, CountedEpisodes};
use sortie_cli::proposals::ProposalArguments;
use sortie_cli::subject::Subject;
use sortie_cli::subject_allocator;

/// By how much an int8 plan may succeed less often than the exact plan.
const MARGIN: f64 = 0.01;

/// Episodes that both plans play.
const JUDGED: usize = 2000;

/// Episodes whose observations weights are rounded for.
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

/// Compiles a bundle.
pub(super) fn compile_bundle(arguments: &CompileArguments) -> Outcome {
    let refused =
        [("--observations", arguments.observations.is_some()), ("--npz", arguments.npz.is_some())];
    if let Some((flag, _)) = refused.into_iter().find(|(_, is_given)| *is_given) {
        let message =
            format!("`{flag}` is for an ONNX file: a bundle's agents play, and are recorded");
        return Err(Failure::new(Exit::Usage, message));
    }
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

/// Writes a bundle again, with plans.
fn ship(arguments: &CompileArguments) -> Outcome {
    let CompileArguments { onnx: folder, output, common, .. } = arguments;
    let draft = open_bundle(folder)?.draft();
    let bundle = with_plans(draft, output)?.write(output)?;
    let (bundle, sha256) = (output, hex(bundle.id()));
    if common.json {
        print_json(&WrittenBundle { bundle, sha256 });
    } else {
        say!("{}: {sha256}", bundle.display());
    }
    Ok(())
}

/// Writes the int8 plan of a bundle's agents, if it succeeds as often as the exact one.
fn compile_int8(arguments: &CompileArguments) -> Outcome {
    let CompileArguments { onnx: folder, output, common, .. } = arguments;
    let playing = Playing::open(open_bundle(folder)?)?;
    try_output(output, Kind::Plan)?;
    let bar = progress::bar(*common, (RECORDED + 2 * JUDGED) as u64, "episodes");
    let bundle = &playing.bundle;
    let mut exact = DeployedPolicy::open(bundle, Backend::Plan)?;
    let mut exact = exact.policy()?;
    let mut recorder = RecordingPolicy::new(exact.as_mut(), bundle);
    let rounding_seed = apart(common.seed);
    playing.play(&mut recorder, RECORDED, rounding_seed, &bar)?;
    let recording = recorder.into_recording();
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
        if !environment.spec().has_success {
            let message = format!(
                "an int8 plan of a bundle is judged by success, and episodes of `{set}` cannot be solved: compile each \
                 of its networks with recorded inputs, `sortie compile FILE.onnx --profile int8 --npz FILE`"
            );
            return Err(Failure::new(Exit::Usage, message));
        }
        let subject = Subject::Bundle(Box::new(bundle.clone()));
        Ok(Self { bundle, subject, set, environment })
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
        if self.bundle.contract().subtask_conditioning == SubtaskConditioning::None {
            let mut team = play::PolicyTeam::new(policy);
            let played =
                play::evaluate_watched(&*self.environment, &mut team, episodes, seed, &mut counted);
            return Ok(played?);
        }
        let name = self.bundle.folder().to_string_lossy();
        let draws = (ProposalArguments::default(), seed);
        let team = (&self.subject, self.set.entry());
        let opened =
            subject_allocator::open_for(team, None, &self.subject, &name, Backend::Plan, draws);
        let (_, mut allocator) = opened?;
        let plan = EvaluationPlan::new(&*self.environment, episodes, seed);
        let (mut team, mut allocator) = (PolicyTeam::new(policy), allocator.allocator()?);
        Ok(evaluate_watched(&plan, &mut team, &mut *allocator, &mut counted)?)
    }
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
