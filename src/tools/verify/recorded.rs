//! A policy that somebody else exported, beside what was recorded of it, or its engines beside each other.

use std::path::Path;

use sortie_cli::failure::{Exit, Failure};
use sortie_cli::foreign::ENGINE;
use sortie_cli::npz::{self, Array, Arrays, RecordedInputs};
use sortie_cli::output::tell;
use sortie_cli::tools::{compiler, engines};
use sortie_core::plan::AlignedBytes;
use sortie_plans::{
    Comparison, CompileError, CompileOptions, CompiledPolicy, FlatPolicy, OutputRole,
    PlanFlatPolicy, PolicyAnswer, PolicyFacts, PolicyOptions, PolicyOutput, RecordedCase,
    TrueFlatPolicy, TrueNumber, choices, finite_score, random_policy_inputs, read_onnx,
};

use super::networks::known;
use super::{Compared, DOUBLE, Judges, Report, VerifyArguments, within};

/// Steps that recurrent policies take with their states fed back.
const STEPS: usize = 100;

/// Random inputs after which they begin without memory again.
const FED_BACK: usize = 16;

/// Multiply-adds of all inputs together, which the reference evaluator does nine times over in some seconds.
const MOST_MULTIPLY_ADDS: u64 = 1_000_000_000;

/// Compares the engines with recorded answers, recurrent policies also with each other, step by step; where nothing was
/// recorded, all with each other on random inputs.
pub(super) fn compare(
    arguments: &VerifyArguments,
    recorded: Option<&Path>,
    judges: &Judges,
) -> Result<Report, Failure> {
    let subject = &arguments.subject;
    let options = arguments.policy.options_for(subject)?;
    let onnx = read_onnx(subject).map_err(|error| Failure::file(subject, &error))?;
    let failed = within(subject);
    // What this process reads has then been read and run elsewhere.
    let facts = compiler().rehearse_policy(&onnx, &options).map_err(&failed)?;
    let seeded = (&options, arguments.common.seed);
    let compiled = compiled_policy(&onnx, seeded, arguments.common.quiet).map_err(&failed)?;
    let plan = compiled.as_ref().map(|compiled| compiled.compiled.bytes.as_slice());
    let peers = (arguments, judges);
    let engines = Engines { onnx: &onnx, options: &options, facts: &facts };
    let compared = match recorded {
        Some(file) => {
            let arrays = npz::read(file)?;
            let cases = Cases::of(&facts, &arrays);
            let broken = |reason| format!("{}: {reason}", file.display());
            let cases = cases.map_err(|reason| Failure::new(Exit::BadData, broken(reason)))?;
            engines.compared(peers, plan, |policies, truth| with_recorded(policies, &cases, truth))
        }
        None => engines.on_random_inputs(peers, plan),
    };
    let tract = sortie_cli::tools::engines()?.tract().name();
    let engine = judges.engines.iter().any(|judge| judge.name() == tract).then_some(ENGINE);
    let engines = compared?;
    Ok(Report { engines, not_compared: judges.missing(), engine, is_policy: true })
}

/// A policy's plan beside the engines on random inputs.
pub(super) fn judged_plan(
    (arguments, judges): (&VerifyArguments, &Judges),
    onnx: &[u8],
    options: &PolicyOptions,
    plan: &[u8],
) -> Result<Vec<Compared>, Failure> {
    let facts = compiler().rehearse_policy(onnx, options).map_err(within(&arguments.subject))?;
    let engines = Engines { onnx, options, facts: &facts };
    engines.on_random_inputs((arguments, judges), Some(plan))
}

/// A policy that several engines run.
struct Engines<'a> {
    onnx: &'a [u8],
    options: &'a PolicyOptions,
    facts: &'a PolicyFacts,
}

/// Policies by the names of their engines.
type Policies<'p> = Vec<(&'static str, Box<dyn FlatPolicy + 'p>)>;

impl Engines<'_> {
    fn on_random_inputs(
        &self,
        peers: (&VerifyArguments, &Judges),
        plan: Option<&[u8]>,
    ) -> Result<Vec<Compared>, Failure> {
        let (arguments, _) = peers;
        let (count, seed) = (arguments.inputs as usize, arguments.common.seed);
        let inputs = random_policy_inputs(count, self.facts, seed);
        self.compared(peers, plan, |policies, truth| {
            with_each_other(policies, self.facts, &inputs, truth)
        })
    }

    /// What a comparison finds between plan, engines and truth.
    fn compared(
        &self,
        (arguments, judges): (&VerifyArguments, &Judges),
        plan: Option<&[u8]>,
        compare: impl FnOnce(&mut Policies<'_>, &mut Option<Truth>) -> Vec<Compared>,
    ) -> Result<Vec<Compared>, Failure> {
        let Self { onnx, options, facts } = *self;
        let failed = within(&arguments.subject);
        let plan = plan.map(AlignedBytes::copy_of);
        let mut policies: Policies<'_> = Vec::new();
        if let Some(plan) = &plan {
            let plan = PlanFlatPolicy::load(plan.as_slice(), facts.clone()).map_err(&failed)?;
            policies.push(("plan", Box::new(plan)));
        }
        for judge in &judges.engines {
            let policy = judge.flat_policy(onnx, options).map_err(&failed)?;
            policies.push((judge.name(), policy));
        }
        let affordable = facts.affordable(usize::MAX, MOST_MULTIPLY_ADDS);
        let truth = known(engines()?.truth(onnx, options));
        let mut truth = truth.map(|policy| Truth { policy, affordable });
        Ok(compare(&mut policies, &mut truth))
    }
}

/// The file in double precision, for as many inputs as a few seconds allow.
struct Truth {
    policy: Box<dyn TrueFlatPolicy>,
    affordable: usize,
}

/// All outputs of one input, states behind the others; none where they are not known.
type True = Option<Vec<Vec<TrueNumber>>>;

impl Truth {
    /// The truth of every recorded case.
    fn of_cases(&mut self, cases: &Cases<'_>) -> Vec<True> {
        let run = |case| {
            let RecordedCase { inputs, states } = cases.inputs.case(case);
            self.policy.run(&inputs, Some(&states.unwrap_or_default())).ok()
        };
        (0..cases.inputs.count.min(self.affordable)).map(run).collect()
    }

    /// The truth of inputs one after the other, as [`steps`] has them.
    fn of_steps(&mut self, inputs: &[Vec<&[f32]>], episode: usize) -> Vec<True> {
        let run = |(index, given): (usize, &Vec<&[f32]>)| {
            if index % episode == 0 {
                self.policy.begin();
            }
            let found = self.policy.run(given, None).ok();
            let is_finite = |numbers: &Vec<TrueNumber>| numbers.iter().all(|n| n.is_finite());
            if !found.as_ref().is_some_and(|found| found.iter().all(is_finite)) {
                self.policy.begin();
            }
            found
        };
        inputs.iter().take(self.affordable).enumerate().map(run).collect()
    }
}

/// All policies before what was recorded.
fn with_recorded(
    policies: &mut Policies<'_>,
    cases: &Cases<'_>,
    truth: &mut Option<Truth>,
) -> Vec<Compared> {
    let truths = truth.as_mut().map_or_else(Vec::new, |truth| truth.of_cases(cases));
    let inputs: Vec<_> =
        (0..STEPS).map(|step| cases.inputs.case(step % cases.inputs.count).inputs).collect();
    let mut compared = Vec::new();
    let mut fed_back = Vec::new();
    for (engine, policy) in policies {
        let name = format!("{engine} against recorded");
        compared.push(Compared::new(name, cases.recorded(engine, policy.as_mut(), &truths)));
        if cases.facts.state_length() > 0 {
            fed_back.push((*engine, steps(engine, policy.as_mut(), &inputs, STEPS)));
        }
    }
    let how = format!("{STEPS} steps with the state fed back");
    if !fed_back.is_empty() {
        let truths = truth.as_mut().map_or_else(Vec::new, |truth| truth.of_steps(&inputs, STEPS));
        compared.extend(pairs(cases.facts, &fed_back, &truths, &how));
    }
    compared
}

/// All policies before each other.
fn with_each_other(
    policies: &mut Policies<'_>,
    facts: &PolicyFacts,
    inputs: &[Vec<Vec<f32>>],
    truth: &mut Option<Truth>,
) -> Vec<Compared> {
    let inputs: Vec<Vec<&[f32]>> =
        inputs.iter().map(|given| given.iter().map(Vec::as_slice).collect()).collect();
    let mut answered = Vec::new();
    for (engine, policy) in policies {
        answered.push((*engine, steps(engine, policy.as_mut(), &inputs, FED_BACK)));
    }
    let how = match facts.state_length() {
        0 => "random inputs".to_owned(),
        _ => format!("random inputs, the state fed back for {FED_BACK}"),
    };
    let truths = truth.as_mut().map_or_else(Vec::new, |truth| truth.of_steps(&inputs, FED_BACK));
    pairs(facts, &answered, &truths, &how)
}

/// What a policy gives for inputs one after the other; its memory is emptied before every so many, and behind an input
/// that has no answer, none at all or one that is no finite number.
fn steps(
    engine: &str,
    policy: &mut dyn FlatPolicy,
    inputs: &[Vec<&[f32]>],
    episode: usize,
) -> Vec<Option<Step>> {
    let mut states = vec![0.0; policy.facts().state_length()];
    let mut refusals = Refusals { engine, is_said: false };
    let step = |(index, given): (usize, &Vec<&[f32]>)| {
        if index % episode == 0 {
            states.fill(0.0);
        }
        let step = policy.run(given, &mut states);
        let step = step.map(|answers| Step { answers, states: states.clone() });
        let answered = refusals.noted(index, step).filter(Step::is_finite);
        if answered.is_none() {
            states.fill(0.0);
        }
        answered
    };
    inputs.iter().enumerate().map(step).collect()
}

/// Says which input an engine first gave no answer to, and why; comparisons count them.
struct Refusals<'a> {
    engine: &'a str,
    is_said: bool,
}

impl Refusals<'_> {
    fn noted(&mut self, case: usize, step: Result<Step, CompileError>) -> Option<Step> {
        if let (Err(error), false) = (&step, self.is_said) {
            tell!("note: {} has no answer to case {case}: {error}", self.engine);
            self.is_said = true;
        }
        step.ok()
    }
}

/// Every two that answered, step by step, and each beside the truth.
fn pairs(
    facts: &PolicyFacts,
    answered: &[(&str, Vec<Option<Step>>)],
    truths: &[True],
    how: &str,
) -> Vec<Compared> {
    let mut compared = Vec::new();
    for (index, (one, got)) in answered.iter().enumerate() {
        for (other, want) in answered.iter().skip(index + 1) {
            let name = format!("{one} against {other}, {how}");
            compared.push(Compared::new(name, step_by_step(facts, got, want, truths)));
        }
    }
    for (engine, got) in answered.iter().filter(|_| !truths.is_empty()) {
        let name = format!("{engine} against {DOUBLE}, {how}");
        compared.push(Compared::new(name, beside_truth(facts, got, truths)));
    }
    compared
}

/// The policy's plan; where a node has no step that is said, and the other engines are compared.
fn compiled_policy(
    onnx: &[u8],
    (policy, seed): (&PolicyOptions, u64),
    quiet: bool,
) -> Result<Option<CompiledPolicy>, CompileError> {
    let options = CompileOptions { seed, ..CompileOptions::default() };
    match compiler().compile_policy(onnx, policy, &options) {
        Ok(compiled) => Ok(Some(compiled)),
        Err(error @ CompileError::Unsupported { .. }) => {
            if !quiet {
                tell!("note: there is no plan of this file to compare: {error}");
            }
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// What was recorded, in the order in which a policy takes and gives it.
struct Cases<'a> {
    facts: &'a PolicyFacts,
    inputs: RecordedInputs<'a>,
    /// What came out; next states need not have been recorded.
    answers: Vec<Option<&'a Array>>,
}

/// What a policy gave and what it remembered then.
struct Step {
    answers: Vec<PolicyAnswer>,
    states: Vec<f32>,
}

impl<'a> Cases<'a> {
    fn of(facts: &'a PolicyFacts, arrays: &'a Arrays) -> Result<Self, String> {
        let inputs = RecordedInputs::of(facts, arrays)?;
        let missing = facts.states.first().filter(|_| !inputs.has_states());
        if let Some(state) = missing {
            return Err(inputs.missing(&format!("in__{}", state.input)));
        }
        let answers = facts.outputs.iter().map(|output| {
            let name = format!("out__{}", output.name);
            match output.role {
                OutputRole::State => inputs.found(&name, output.length()),
                _ => inputs.needed(&name, output.length()).map(Some),
            }
        });
        let answers: Vec<Option<&Array>> = answers.collect::<Result<_, _>>()?;
        Ok(Self { facts, inputs, answers })
    }

    /// A comparison for each output. A refusal is right where what was recorded is no finite number.
    fn recorded(
        &self,
        engine: &str,
        policy: &mut dyn FlatPolicy,
        truths: &[True],
    ) -> Vec<Comparison> {
        let mut comparisons: Vec<Comparison> = named(self.facts);
        let mut refusals = Refusals { engine, is_said: false };
        for case in 0..self.inputs.count {
            let RecordedCase { inputs, states } = self.inputs.case(case);
            let mut states = states.unwrap_or_default();
            let answers = policy.run(&inputs, &mut states);
            let step = answers.map(|answers| Step { answers, states });
            let got = refusals.noted(case, step).map(|step| step.outputs(self.facts));
            let wanted = self.answers.iter().zip(&self.facts.outputs);
            let wanted = wanted.map(|(want, output)| {
                let numbers = self.inputs.numbers((*want)?, case).iter().copied();
                Some(match output.role {
                    OutputRole::Discrete(_) => numbers.map(finite_score).collect(),
                    _ => numbers.collect::<Vec<f32>>(),
                })
            });
            let wanted: Vec<Option<Vec<f32>>> = wanted.collect();
            let has_answer = wanted.iter().flatten().flatten().all(|number| number.is_finite());
            for (place, comparison) in comparisons.iter_mut().enumerate() {
                let Some(Some(want)) = wanted.get(place) else { continue };
                let truth = truth_of(truths, case, place);
                match got.as_ref().and_then(|got| got.get(place)) {
                    Some(got) => add(comparison, &self.facts.outputs[place], got, want, truth),
                    None => comparison.add_refusal(!has_answer),
                }
            }
        }
        comparisons.retain(|comparison| comparison.inputs > 0);
        comparisons
    }
}

impl Step {
    fn is_finite(&self) -> bool {
        let answers = self.answers.iter().flat_map(|answer| &answer.numbers);
        answers.chain(&self.states).all(|number| number.is_finite())
    }

    /// An answer for each output, states among them.
    fn outputs(&self, facts: &PolicyFacts) -> Vec<PolicyAnswer> {
        let mut states = self.states.as_slice();
        let next = facts.states.iter().map(|state| {
            let (numbers, rest) = states.split_at_checked(state.length).unwrap_or_default();
            states = rest;
            PolicyAnswer { numbers: numbers.to_vec(), scores: Vec::new() }
        });
        self.answers.iter().cloned().chain(next).collect()
    }
}

/// Nothing compared yet of each output.
fn named(facts: &PolicyFacts) -> Vec<Comparison> {
    facts.outputs.iter().map(|output| Comparison::new(&output.name)).collect()
}

/// What is known of an output in a case.
fn truth_of(truths: &[True], case: usize, output: usize) -> Option<&[TrueNumber]> {
    truths.get(case)?.as_ref()?.get(output).map(Vec::as_slice)
}

/// Compares two engines step by step.
fn step_by_step(
    facts: &PolicyFacts,
    got: &[Option<Step>],
    want: &[Option<Step>],
    truths: &[True],
) -> Vec<Comparison> {
    let mut comparisons = named(facts);
    for (case, (got, want)) in got.iter().zip(want).enumerate() {
        let (Some(got), Some(want)) = (got, want) else {
            let both = got.is_none() && want.is_none();
            comparisons.iter_mut().for_each(|comparison| comparison.add_refusal(both));
            continue;
        };
        let both = got.outputs(facts).into_iter().zip(want.outputs(facts));
        for (place, (comparison, (got, want))) in comparisons.iter_mut().zip(both).enumerate() {
            let truth = truth_of(truths, case, place);
            add(comparison, &facts.outputs[place], &got, &want.numbers, truth);
        }
    }
    comparisons
}

/// Compares an engine with the truth, as far as it is known.
fn beside_truth(facts: &PolicyFacts, got: &[Option<Step>], truths: &[True]) -> Vec<Comparison> {
    let mut comparisons = named(facts);
    for (got, truth) in got.iter().zip(truths) {
        let Some(truth) = truth else { continue };
        let is_sure = truth.iter().flatten().all(|number| number.is_sure());
        let has_answer = truth.iter().flatten().all(|number| number.is_finite());
        let got = got.as_ref().map(|step| step.outputs(facts));
        for (place, comparison) in comparisons.iter_mut().enumerate() {
            let (output, Some(truth)) = (&facts.outputs[place], truth.get(place)) else { continue };
            match got.as_ref().and_then(|got| got.get(place)) {
                // Right engines answer or not, as their rounding falls.
                _ if !is_sure => comparison.add_refusal(true),
                None => comparison.add_refusal(!has_answer),
                Some(_) if !has_answer => comparison.add_refusal(false),
                Some(got) => {
                    let want = true_answer(output, truth);
                    // The truth itself scatters not at all: all of the distance is the engine's.
                    let doubled: Vec<TrueNumber> = truth
                        .iter()
                        .map(|number| TrueNumber { scatter: number.scatter / 2.0, ..*number })
                        .collect();
                    add(comparison, output, got, &want, Some(&doubled));
                }
            }
        }
    }
    comparisons
}

/// The true numbers of an output, or the places of the largest true scores, where it chooses.
fn true_answer(output: &PolicyOutput, truth: &[TrueNumber]) -> Vec<f32> {
    let values: Vec<f32> = truth.iter().map(|number| number.value as f32).collect();
    match output.role {
        OutputRole::Discrete(actions) if values.len() != output.length() => {
            choices(&values, actions).map(|place| place as f32).collect()
        }
        _ => values,
    }
}

/// Adds what came of an output in one case.
fn add(
    comparison: &mut Comparison,
    output: &PolicyOutput,
    got: &PolicyAnswer,
    want: &[f32],
    truth: Option<&[TrueNumber]>,
) {
    let whole = !output.kind.is_float();
    let (error, same) = match output.role {
        OutputRole::Discrete(actions) if whole => {
            (choice_error(actions, got, want), got.numbers == want)
        }
        OutputRole::Discrete(actions) => (
            largest_error(&got.numbers, want),
            choices(&got.numbers, actions).eq(choices(want, actions)),
        ),
        _ if whole && got.numbers != want => (f32::INFINITY, true),
        _ => (largest_error(&got.numbers, want), true),
    };
    // Where the truth is no number it says nothing of others.
    let truth = truth.filter(|truth| truth.iter().all(|number| number.is_finite()));
    let Some(truth) = truth else { return comparison.add_error(error, same) };
    let distance = match output.role {
        OutputRole::Discrete(actions) if truth.len() != want.len() => {
            choice_distance(actions, &got.numbers, want, truth)
        }
        _ => largest_distance(&got.numbers, want, truth),
    };
    comparison.add_distance(distance, error, same);
}

/// The largest distance of two engines' numbers, each of which may scatter.
fn largest_distance(got: &[f32], want: &[f32], truth: &[TrueNumber]) -> f64 {
    if got.len() != want.len() || truth.len() != want.len() {
        return f64::INFINITY;
    }
    let numbers = got.iter().zip(want).zip(truth);
    let distances = numbers.map(|((got, want), truth)| truth.between(*got, *want));
    distances.fold(
        0.0,
        |most, distance| if distance > most || distance.is_nan() { distance } else { most },
    )
}

/// How far the true scores of other choices lie apart, which both may scatter.
fn choice_distance(actions: usize, got: &[f32], want: &[f32], scores: &[TrueNumber]) -> f64 {
    let rows = scores.chunks_exact(actions.max(1));
    if got.len() != want.len() || rows.len() != want.len() {
        return if got == want { 0.0 } else { f64::INFINITY };
    }
    let distance = |(row, (got, want)): (&[TrueNumber], (&f32, &f32))| {
        let score = |place: f32| row.get(place as usize).copied();
        match (score(*got), score(*want)) {
            _ if got == want => 0.0,
            (Some(got), Some(want)) => got.apart(want),
            _ => f64::INFINITY,
        }
    };
    rows.zip(got.iter().zip(want)).map(distance).fold(0.0, f64::max)
}

/// The largest |a - b| / (1 + |b|); infinite where one of them is no number, or they differ in their infinities.
fn largest_error(got: &[f32], want: &[f32]) -> f32 {
    let error = |(got, want): (&f32, &f32)| match (got - want).abs() / (1.0 + want.abs()) {
        _ if got == want || got.is_nan() && want.is_nan() => 0.0,
        error if error.is_finite() => error,
        _ => f32::INFINITY,
    };
    let lengths = if got.len() == want.len() { 0.0 } else { f32::INFINITY };
    got.iter().zip(want).map(error).fold(lengths, f32::max)
}

/// How far the scores of other choices lie behind: another choice between equal scores is none.
fn choice_error(actions: usize, got: &PolicyAnswer, want: &[f32]) -> f32 {
    if got.numbers == want {
        return 0.0;
    }
    let rows = got.scores.chunks_exact(actions.max(1));
    if rows.len() != want.len() || want.len() != got.numbers.len() {
        return f32::INFINITY;
    }
    let score = |row: &[f32], place: f32| row.get(place as usize).copied();
    let of_rows = rows.zip(got.numbers.iter().zip(want)).map(|(row, (got, want))| {
        match (score(row, *got), score(row, *want)) {
            (Some(got), Some(want)) => largest_error(&[got], &[want]),
            _ => f32::INFINITY,
        }
    });
    of_rows.fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use sortie_plans::ValueType;

    use super::*;

    fn compared(kind: ValueType, role: OutputRole, got: PolicyAnswer, want: &[f32]) -> Comparison {
        let shape = vec![1, got.numbers.len()];
        let output = PolicyOutput { name: "out".to_owned(), kind, shape, role };
        let mut comparison = Comparison::new("out");
        add(&mut comparison, &output, &got, want, None);
        comparison
    }

    fn numbers(numbers: &[f32]) -> PolicyAnswer {
        PolicyAnswer { numbers: numbers.to_vec(), scores: Vec::new() }
    }

    #[test]
    fn numbers_agree_within_the_tolerance_of_each() {
        let of = |got: f32, want: f32| {
            compared(ValueType::F32, OutputRole::Continuous(2), numbers(&[1.0, got]), &[1.0, want])
        };
        assert!(of(1000.0, 1000.005).agrees() && of(0.0, 0.000_009).agrees());
        assert!(!of(0.0, 0.000_02).agrees());
        assert!(of(f32::NEG_INFINITY, f32::NEG_INFINITY).agrees());
        for (got, want) in [(f32::NAN, 0.0), (f32::INFINITY, 0.0), (0.0, f32::INFINITY)] {
            assert!(!of(got, want).agrees(), "{got} {want}");
        }
        let short =
            compared(ValueType::F32, OutputRole::Continuous(1), numbers(&[1.0]), &[1.0, 2.0]);
        assert!(!short.agrees());
    }

    #[test]
    fn an_input_whose_truth_is_not_known_is_judged_by_its_error() {
        let output = PolicyOutput {
            name: "out".to_owned(),
            kind: ValueType::F32,
            shape: vec![1, 1],
            role: OutputRole::Continuous(1),
        };
        let agrees = |cases: &[(f32, Option<f64>)]| {
            let mut comparison = Comparison::new("out");
            for (got, scatter) in cases {
                let truth = scatter.map(|scatter| [TrueNumber { value: 1.0, scatter }]);
                let truth = truth.as_ref().map(<[_; 1]>::as_slice);
                add(&mut comparison, &output, &numbers(&[*got]), &[1.0], truth);
            }
            comparison.agrees()
        };
        let (near, far) = ((1.0001, Some(1.0e-5)), (1.0001, Some(1.0e-6)));
        assert!(agrees(&[near]) && !agrees(&[far]));
        assert!(agrees(&[near, (1.000_001, None)]) && !agrees(&[near, (1.0001, None)]));
        assert!(!agrees(&[(1.0001, Some(f64::NAN))]), "a truth that is none hides no error");
    }

    #[test]
    fn another_choice_is_right_only_between_equal_scores() {
        let of = |scores: &[f32]| {
            let got = PolicyAnswer { numbers: vec![0.0], scores: scores.to_vec() };
            compared(ValueType::I64, OutputRole::Discrete(3), got, &[2.0])
        };
        let tie = of(&[1.0, 0.0, 0.999_999]);
        assert!(tie.agrees() && tie.action_mismatches == 1);
        assert!(!of(&[1.0, 0.0, 0.9]).agrees());
        assert!(!of(&[]).agrees(), "nobody knows the scores");
        let count = compared(ValueType::I64, OutputRole::Continuous(1), numbers(&[3.0]), &[4.0]);
        assert!(!count.agrees());
    }

    #[test]
    fn scores_that_choose_another_action_are_counted() {
        let got = numbers(&[1.0, 1.000_001]);
        let other = compared(ValueType::F32, OutputRole::Discrete(2), got, &[1.000_001, 1.0]);
        assert!(other.agrees() && other.action_mismatches == 1);
    }
}
