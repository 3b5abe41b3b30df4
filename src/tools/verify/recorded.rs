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
    PlanFlatPolicy, PolicyAnswer, PolicyFacts, PolicyOptions, PolicyOutput, RecordedCase, choices,
    random_policy_inputs, read_onnx,
};

use super::{Compared, Judges, Report, VerifyArguments, within};

/// Steps that recurrent policies take with their states fed back.
const STEPS: usize = 100;

/// Random inputs after which they begin without memory again.
const FED_BACK: usize = 16;

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
    let plan = compiled.as_ref().map(|compiled| AlignedBytes::copy_of(&compiled.compiled.bytes));
    let mut policies: Vec<(&str, Box<dyn FlatPolicy + '_>)> = Vec::new();
    if let Some(plan) = &plan {
        let plan = PlanFlatPolicy::load(plan.as_slice(), facts.clone()).map_err(&failed)?;
        policies.push(("plan", Box::new(plan)));
    }
    for judge in &judges.engines {
        let policy = judge.flat_policy(&onnx, &options).map_err(&failed)?;
        policies.push((judge.name(), policy));
    }
    let compared = match recorded {
        Some(file) => {
            let arrays = npz::read(file)?;
            let cases = Cases::of(&facts, &arrays);
            let broken = |reason| format!("{}: {reason}", file.display());
            let cases = cases.map_err(|reason| Failure::new(Exit::BadData, broken(reason)))?;
            with_recorded(&mut policies, &cases)
        }
        None => {
            let inputs =
                random_policy_inputs(arguments.inputs as usize, &facts, arguments.common.seed);
            with_each_other(&mut policies, &facts, &inputs)
        }
    };
    let tract = engines()?.tract().name();
    let engine = judges.engines.iter().any(|judge| judge.name() == tract).then_some(ENGINE);
    let (engines, not_compared) = (compared.map_err(&failed)?, judges.missing());
    Ok(Report { engines, not_compared, engine, is_policy: true })
}

/// All policies before what was recorded.
fn with_recorded(
    policies: &mut [(&str, Box<dyn FlatPolicy + '_>)],
    cases: &Cases<'_>,
) -> Result<Vec<Compared>, CompileError> {
    let inputs: Vec<_> =
        (0..STEPS).map(|step| cases.inputs.case(step % cases.inputs.count).inputs).collect();
    let mut compared = Vec::new();
    let mut fed_back = Vec::new();
    for (engine, policy) in policies {
        let name = format!("{engine} against recorded");
        compared.push(Compared::new(name, cases.recorded(policy.as_mut())?));
        if cases.facts.state_length() > 0 {
            fed_back.push((*engine, steps(policy.as_mut(), &inputs, STEPS)?));
        }
    }
    let how = format!("{STEPS} steps with the state fed back");
    compared.extend(pairs(cases.facts, &fed_back, &how));
    Ok(compared)
}

/// All policies before each other.
fn with_each_other(
    policies: &mut [(&str, Box<dyn FlatPolicy + '_>)],
    facts: &PolicyFacts,
    inputs: &[Vec<Vec<f32>>],
) -> Result<Vec<Compared>, CompileError> {
    let inputs: Vec<Vec<&[f32]>> =
        inputs.iter().map(|given| given.iter().map(Vec::as_slice).collect()).collect();
    let mut answered = Vec::new();
    for (engine, policy) in policies {
        answered.push((*engine, steps(policy.as_mut(), &inputs, FED_BACK)?));
    }
    let how = match facts.state_length() {
        0 => "random inputs".to_owned(),
        _ => format!("random inputs, the state fed back for {FED_BACK}"),
    };
    Ok(pairs(facts, &answered, &how))
}

/// What a policy gives for inputs one after the other; its memory is emptied before every so many.
fn steps(
    policy: &mut dyn FlatPolicy,
    inputs: &[Vec<&[f32]>],
    episode: usize,
) -> Result<Vec<Step>, CompileError> {
    let mut states = vec![0.0; policy.facts().state_length()];
    let step = |(index, given): (usize, &Vec<&[f32]>)| {
        if index % episode == 0 {
            states.fill(0.0);
        }
        let answers = policy.run(given, &mut states)?;
        Ok(Step { answers, states: states.clone() })
    };
    inputs.iter().enumerate().map(step).collect()
}

/// Every two that answered, step by step.
fn pairs(facts: &PolicyFacts, answered: &[(&str, Vec<Step>)], how: &str) -> Vec<Compared> {
    let mut compared = Vec::new();
    for (index, (one, got)) in answered.iter().enumerate() {
        for (other, want) in answered.iter().skip(index + 1) {
            let name = format!("{one} against {other}, {how}");
            compared.push(Compared::new(name, step_by_step(facts, got, want)));
        }
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

    /// A comparison for each output.
    fn recorded(&self, policy: &mut dyn FlatPolicy) -> Result<Vec<Comparison>, CompileError> {
        let mut comparisons: Vec<Comparison> = named(self.facts);
        for case in 0..self.inputs.count {
            let RecordedCase { inputs, states } = self.inputs.case(case);
            let mut states = states.unwrap_or_default();
            let answers = policy.run(&inputs, &mut states)?;
            let got = Step { answers, states }.outputs(self.facts);
            let compared =
                self.facts.outputs.iter().zip(&mut comparisons).zip(got).zip(&self.answers);
            for (((output, comparison), got), want) in compared {
                if let Some(want) = want {
                    add(comparison, output, &got, self.inputs.numbers(want, case));
                }
            }
        }
        comparisons.retain(|comparison| comparison.inputs > 0);
        Ok(comparisons)
    }
}

impl Step {
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

/// Compares two engines step by step.
fn step_by_step(facts: &PolicyFacts, got: &[Step], want: &[Step]) -> Vec<Comparison> {
    let mut comparisons = named(facts);
    for (got, want) in got.iter().zip(want) {
        let both = got.outputs(facts).into_iter().zip(want.outputs(facts));
        for ((output, comparison), (got, want)) in
            facts.outputs.iter().zip(&mut comparisons).zip(both)
        {
            add(comparison, output, &got, &want.numbers);
        }
    }
    comparisons
}

/// Adds what came of an output in one case.
fn add(comparison: &mut Comparison, output: &PolicyOutput, got: &PolicyAnswer, want: &[f32]) {
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
    comparison.add_error(error, same);
}

/// The largest |a - b| / (1 + |b|); infinite where one of them is no number, or they differ in their infinities.
fn largest_error(got: &[f32], want: &[f32]) -> f32 {
    let error = |(got, want): (&f32, &f32)| match (got - want).abs() / (1.0 + want.abs()) {
        _ if got == want => 0.0,
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
        add(&mut comparison, &output, &got, want);
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
