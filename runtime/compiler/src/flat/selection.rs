//! What is taken of a file: the wanted outputs, and the states that they need.

use std::collections::HashSet;

use sortie_plans::{CompileError, OutputRole, PolicyOptions, ValueType};
use tract_onnx::pb;

use super::nodes::{ArgMax, LIKELIEST, Nodes};
use super::values::{Value, Values, listed};

/// What is taken of a file.
pub(super) struct Selection {
    pub(super) wanted: Vec<Wanted>,
    /// What the wanted outputs choose, where they are choices.
    pub(super) choices: Vec<Option<ArgMax>>,
    pub(super) states: Vec<Pair>,
}

impl Selection {
    pub(super) fn of(
        file: &pb::ModelProto,
        values: &Values,
        options: &PolicyOptions,
    ) -> Result<Self, CompileError> {
        let graph = file.graph.clone().unwrap_or_default();
        let nodes = Nodes::of(&graph);
        let pairs = find(values, &options.states)?;
        let is_state = |name: &str| pairs.iter().any(|pair| pair.output == name);
        let others: Vec<&Value> =
            values.outputs.iter().filter(|output| !is_state(&output.name)).collect();
        let told = |output: &Value| {
            let behind = nodes.behind([output.name.as_str()]);
            let is_whole = output.kind.is_some_and(ValueType::is_integer);
            Told {
                is_choice: is_whole && nodes.argmax(&output.name).is_some(),
                is_drawn: nodes.drawn(&output.name).is_some(),
                is_constant: !values.inputs.iter().any(|input| behind.contains(&input.name)),
            }
        };
        let wanted = wanted(&others, told, &options.outputs)
            .map_err(|error| with_state(error, values, &others, options))?;
        refuse_drawn(&nodes, &wanted, &options.outputs)?;
        let choices = wanted.iter().map(|wanted| nodes.argmax(&wanted.name)).collect();
        let (states, behind) = needed(&nodes, &wanted, pairs);
        if options.states.is_empty() {
            let is_wanted = |name: &str| wanted.iter().any(|wanted| wanted.name == name);
            let is_state = |name: &str| states.iter().any(|pair| pair.input == name);
            let inputs = values
                .inputs
                .iter()
                .filter(|input| behind.contains(&input.name) && !is_state(&input.name));
            let may_return = |output: &&Value| {
                let Told { is_drawn, is_constant, .. } = told(output);
                !is_wanted(&output.name) && !is_drawn && !is_constant
            };
            let outputs = others.iter().copied().filter(may_return);
            refuse_hidden(&inputs.collect::<Vec<_>>(), &outputs.collect::<Vec<_>>())?;
        }
        Ok(Self { wanted, choices, states })
    }

    /// The outputs of the cut file, none twice.
    pub(super) fn outputs(&self) -> Vec<String> {
        let wanted = self.wanted.iter().map(|wanted| &wanted.name);
        let states = self.states.iter().map(|pair| &pair.output);
        let scores = self.choices.iter().flatten().map(|choice| &choice.scores);
        let mut seen = HashSet::new();
        let names = wanted.chain(states).chain(scores).filter(|name| seen.insert(*name));
        names.cloned().collect()
    }
}

/// Says at once which output may be wanted and which state comes back, where neither has a name that tells.
fn with_state(
    error: CompileError,
    values: &Values,
    outputs: &[&Value],
    options: &PolicyOptions,
) -> CompileError {
    let CompileError::Unclear { what, candidates, .. } = &error else { return error };
    let floats: Vec<&Value> = values.inputs.iter().filter(|input| input.is_float()).collect();
    let returns = |output: &&&Value| {
        output.is_float() && floats.iter().any(|input| input.shape == output.shape)
    };
    let (back, others): (Vec<&&Value>, Vec<&&Value>) = outputs.iter().partition(returns);
    let ([back], [other]) = (&back[..], &others[..]) else { return error };
    let inputs: Vec<&&Value> = floats.iter().filter(|input| input.shape == back.shape).collect();
    let ([input], 2..) = (&inputs[..], floats.len()) else { return error };
    if !(options.states.is_empty() && options.outputs.is_empty()) {
        return error;
    }
    let (wanted, input, output) = (&other.name, &input.name, &back.name);
    let flag = format!("`--output {wanted} --state {input}:{output}` if that is what comes back");
    CompileError::Unclear { what: what.clone(), candidates: candidates.clone(), flag: flag.into() }
}

/// Refuses wanted outputs that come out otherwise every time.
fn refuse_drawn(
    nodes: &Nodes<'_>,
    wanted: &[Wanted],
    asked: &[String],
) -> Result<(), CompileError> {
    for Wanted { name, .. } in wanted {
        let Some(node) = nodes.drawn(name) else { continue };
        let likeliest = format!("{name}{LIKELIEST}");
        if asked.contains(&likeliest) {
            let reason = format!("nothing is the likeliest of what {} draws", node.op_type);
            return Err(CompileError::NoPolicy { reason });
        }
        return Err(CompileError::Unclear {
            what: "what is wanted of numbers that are drawn at random".into(),
            candidates: format!("`{name}`, by {}", node.op_type),
            flag: format!(
                "`--output {likeliest}` for a normal's mean or the most probable of several"
            )
            .into(),
        });
    }
    Ok(())
}

/// The states that the wanted outputs need, those among them that these states need, and the names of all behind them.
fn needed(nodes: &Nodes<'_>, wanted: &[Wanted], pairs: Vec<Pair>) -> (Vec<Pair>, HashSet<String>) {
    let mut behind = nodes.behind(wanted.iter().map(|wanted| wanted.name.as_str()));
    loop {
        let needed = pairs.iter().filter(|pair| behind.contains(&pair.input));
        let missing: Vec<&str> = needed
            .map(|pair| pair.output.as_str())
            .filter(|output| !behind.contains(*output))
            .collect();
        if missing.is_empty() {
            break;
        }
        behind.extend(nodes.behind(missing));
    }
    let states = pairs.into_iter().filter(|pair| behind.contains(&pair.input)).collect();
    (states, behind)
}

/// Words that say which way a value goes.
const DIRECTIONS: [&str; 14] = [
    "in", "ins", "input", "inputs", "out", "outs", "output", "outputs", "new", "next", "prev",
    "previous", "last", "old",
];

/// Words of recurrent states, [`word`] applied.
const STATES: [&str; 15] = [
    "h",
    "c",
    "hidden",
    "cell",
    "state",
    "rnn",
    "gru",
    "lstm",
    "memory",
    "carry",
    "recurrent",
    "history",
    "frames",
    "stack",
    "buffer",
];

/// What says that there is no state.
pub(super) const NONE: &str = "none";

/// A state, by the names of its input and of its output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Pair {
    pub(super) input: String,
    pub(super) output: String,
}

/// The states that are asked for, else those that names and shapes tell, in the order of their inputs.
pub(super) fn find(values: &Values, asked: &[String]) -> Result<Vec<Pair>, CompileError> {
    let mut pairs = match asked {
        [] => found(values)?,
        [none] if none == NONE => Vec::new(),
        asked => asked.iter().map(|asked| named_state(values, asked)).collect::<Result<_, _>>()?,
    };
    let place = |pair: &Pair| values.inputs.iter().position(|input| input.name == pair.input);
    pairs.sort_by_key(place);
    let mut seen = HashSet::new();
    match pairs.iter().find(|pair| !(seen.insert(&pair.input) && seen.insert(&pair.output))) {
        Some(twice) => Err(unclear_state(format!("`{}` and `{}`", twice.input, twice.output))),
        None => Ok(pairs),
    }
}

/// The state that `IN:OUT` names; names may have colons themselves.
fn named_state(values: &Values, asked: &str) -> Result<Pair, CompileError> {
    let has = |values: &[Value], name: &str| values.iter().any(|value| value.name == name);
    let splits = asked.match_indices(':').filter_map(|(at, _)| asked.split_at_checked(at));
    let mut pairs = splits.map(|(input, output)| (input, output.trim_start_matches(':')));
    let pair =
        pairs.find(|(input, output)| has(&values.inputs, input) && has(&values.outputs, output));
    let pair = pair.map(|(input, output)| Pair { input: input.into(), output: output.into() });
    let all = values.inputs.iter().chain(&values.outputs);
    pair.ok_or_else(|| CompileError::NotInFile {
        what: "input and output".into(),
        name: asked.into(),
        found: listed(all.map(ToString::to_string)),
    })
}

/// Inputs named like states, each with the output of its shape that is named alike.
fn found(values: &Values) -> Result<Vec<Pair>, CompileError> {
    let mut pairs = Vec::new();
    for input in values.inputs.iter().filter(|input| input.is_float() && is_like_state(&input.name))
    {
        let outputs = |with_numbers: bool| -> Vec<&Value> {
            let alike = |output: &&Value| {
                output.is_float()
                    && fits(input, output)
                    && stem(&input.name, with_numbers) == stem(&output.name, with_numbers)
            };
            values.outputs.iter().filter(alike).collect()
        };
        // `h0` and `h1` are two states, unless only `hn` comes out.
        let same = outputs(true);
        let alike = if same.is_empty() { outputs(false) } else { same };
        match alike.as_slice() {
            [] => {}
            [output] => {
                pairs.push(Pair { input: input.name.clone(), output: output.name.clone() });
            }
            several => {
                let outputs = listed(several.iter().map(ToString::to_string));
                return Err(unclear_state(format!("{input} may come back as {outputs}")));
            }
        }
    }
    pairs.extend(last_of_its_kind(values, &pairs));
    Ok(pairs)
}

/// The only input named like a state, and the only output, that no others of their names were found for: `hidden_state`
/// comes back as `h`.
fn last_of_its_kind(values: &Values, pairs: &[Pair]) -> Option<Pair> {
    let left = |values: &'_ [Value], is_taken: &dyn Fn(&str) -> bool| -> Vec<Value> {
        let is_left = |value: &&Value| {
            value.is_float() && is_like_state(&value.name) && !is_taken(&value.name)
        };
        values.iter().filter(is_left).cloned().collect()
    };
    let inputs = left(&values.inputs, &|name| pairs.iter().any(|pair| pair.input == name));
    let outputs = left(&values.outputs, &|name| pairs.iter().any(|pair| pair.output == name));
    let ([input], [output]) = (&inputs[..], &outputs[..]) else { return None };
    let is_known = output.shape.is_some() && output.shape == input.shape;
    is_known.then(|| Pair { input: input.name.clone(), output: output.name.clone() })
}

/// Refuses an input that only its shape tells to be a state: taken for an observation, it would never change.
///
/// `inputs` are those that are needed and no states, `outputs` those that are neither wanted nor states.
pub(super) fn refuse_hidden(inputs: &[&Value], outputs: &[&Value]) -> Result<(), CompileError> {
    let floats: Vec<_> = inputs.iter().filter(|input| input.is_float()).collect();
    if floats.len() < 2 {
        return Ok(());
    }
    for input in floats {
        let alike = |output: &&&Value| output.is_float() && output.shape == input.shape;
        let alike: Vec<_> = outputs.iter().filter(alike).collect();
        if !alike.is_empty() {
            let outputs = listed(alike.iter().map(ToString::to_string));
            return Err(unclear_state(format!("{input} may come back as {outputs}")));
        }
    }
    Ok(())
}

fn unclear_state(candidates: String) -> CompileError {
    CompileError::Unclear {
        what: "what is a recurrent state".into(),
        candidates,
        flag: "`--state IN:OUT` for each, or `--state none`".into(),
    }
}

/// Whether an output can go in as this input, as far as is known.
fn fits(input: &Value, output: &Value) -> bool {
    output.shape.is_none() || output.shape == input.shape
}

fn is_like_state(name: &str) -> bool {
    stem(name, false).iter().any(|word| STATES.contains(&word.as_str()))
}

/// The words of a name, but for those that say which way it goes.
fn stem(name: &str, with_numbers: bool) -> Vec<String> {
    let words = words(name).into_iter().map(word);
    let is_number = |word: &str| word.chars().all(|letter| letter.is_ascii_digit());
    words
        .filter(|word| !DIRECTIONS.contains(&word.as_str()) && (with_numbers || !is_number(word)))
        .collect()
}

/// One word for all forms of it: `hx`, `hn` and `hy` are `h`.
fn word(word: String) -> String {
    match word.as_str() {
        "hx" | "hy" | "hn" | "ht" => "h".into(),
        "cx" | "cy" | "cn" | "ct" => "c".into(),
        "states" => "state".into(),
        _ => word,
    }
}

/// The words of a name in small letters: they end at other characters, before capitals, and between letters and digits.
pub(super) fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut last = ' ';
    for letter in name.chars() {
        let ends = !letter.is_alphanumeric()
            || last.is_ascii_digit() != letter.is_ascii_digit()
            || last.is_lowercase() && letter.is_uppercase();
        if ends {
            words.push(String::new());
        }
        if let Some(word) = words.last_mut()
            && letter.is_alphanumeric()
        {
            word.extend(letter.to_lowercase());
        }
        last = letter;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// An output that is wanted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Wanted {
    pub(super) name: String,
    /// What its numbers are said to be.
    pub(super) said: Option<Kind>,
}

/// What the numbers of an output are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Discrete,
    Continuous,
}

/// What is told of an output before any is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Told {
    /// It chooses an action.
    pub(super) is_choice: bool,
    /// It is drawn at random.
    pub(super) is_drawn: bool,
    /// Nothing that goes in changes it.
    pub(super) is_constant: bool,
}

/// The outputs that are asked for, in the file's order; else those named as without chance, else the one that chooses an
/// action, else the one that is named like actions or their values, else the only one. `outputs` are those that are no
/// states. What never changes is only wanted where it is asked for, what is drawn stands back behind what is not.
pub(super) fn wanted(
    outputs: &[&Value],
    told: impl Fn(&Value) -> Told,
    asked: &[String],
) -> Result<Vec<Wanted>, CompileError> {
    if !asked.is_empty() {
        let asked: Vec<Wanted> =
            asked.iter().map(|asked| named(outputs, asked)).collect::<Result<_, _>>()?;
        let of = |output: &&Value| asked.iter().find(|wanted| wanted.name == output.name).cloned();
        return Ok(outputs.iter().filter_map(of).collect());
    }
    let outputs: Vec<&Value> =
        outputs.iter().copied().filter(|output| !told(output).is_constant).collect();
    let named = |is_like: fn(&str) -> bool| -> Vec<&Value> {
        let is_like = |output: &&&Value| is_like(&output.name.to_lowercase());
        outputs.iter().filter(is_like).copied().collect()
    };
    let taken = |found: &[&Value]| -> Vec<Wanted> {
        found.iter().map(|output| Wanted { name: output.name.clone(), said: None }).collect()
    };
    let without_chance = named(is_without_chance);
    if !without_chance.is_empty() {
        return Ok(taken(&without_chance));
    }
    let choices: Vec<&Value> =
        outputs.iter().copied().filter(|output| told(output).is_choice).collect();
    for mut found in [choices, named(is_like_actions), named(is_of_actions)] {
        if found.iter().any(|output| !told(output).is_drawn) {
            found.retain(|output| !told(output).is_drawn);
        }
        match found.as_slice() {
            [] => {}
            [one] => return Ok(taken(&with_other_head(one, &outputs))),
            several => return Err(unclear(several)),
        }
    }
    match outputs.as_slice() {
        [] => {
            Err(CompileError::NoPolicy { reason: "it has no output but recurrent states".into() })
        }
        [_] => Ok(taken(&outputs)),
        several => Err(unclear(several)),
    }
}

/// An output and, where it is named as the discrete actions of several kinds, the continuous ones beside it, or the other
/// way round: both act.
fn with_other_head<'v>(one: &'v Value, outputs: &[&'v Value]) -> Vec<&'v Value> {
    let other = |from: &str, to: &str| one.name.contains(from).then(|| one.name.replace(from, to));
    let other = other("discrete", "continuous").or_else(|| other("continuous", "discrete"));
    let is_head =
        |output: &&&Value| output.name == one.name || Some(&output.name) == other.as_ref();
    outputs.iter().filter(is_head).copied().collect()
}

fn named(outputs: &[&Value], asked: &str) -> Result<Wanted, CompileError> {
    let whole = (asked, None);
    let discrete = asked.strip_suffix(":discrete").map(|name| (name, Some(Kind::Discrete)));
    let continuous = asked.strip_suffix(":continuous").map(|name| (name, Some(Kind::Continuous)));
    let likeliest = asked.strip_suffix(LIKELIEST).map(|name| (name, None));
    let mut forms = [Some(whole), discrete, continuous, likeliest].into_iter().flatten();
    let form = forms.find(|(name, _)| outputs.iter().any(|output| output.name == *name));
    let wanted = form.map(|(name, said)| Wanted { name: name.to_owned(), said });
    wanted.ok_or_else(|| CompileError::NotInFile {
        what: "output".into(),
        name: asked.to_owned(),
        found: listed(outputs.iter().map(ToString::to_string)),
    })
}

fn unclear(outputs: &[&Value]) -> CompileError {
    CompileError::Unclear {
        what: "which output is wanted".into(),
        candidates: listed(outputs.iter().map(ToString::to_string)),
        flag: "`--output NAME`".into(),
    }
}

/// Whether a name in small letters says that nothing is drawn at random, beside outputs that are.
fn is_without_chance(name: &str) -> bool {
    name.starts_with("deterministic") && name.contains("action")
}

/// Whether a name in small letters ends as one of actions.
fn is_of_actions(name: &str) -> bool {
    name.ends_with("_action") || name.ends_with("_actions")
}

/// Whether a name in small letters is one of actions, of their values or of what they are drawn around.
fn is_like_actions(name: &str) -> bool {
    name == "mu" || ["action", "q", "logits", "policy"].iter().any(|start| name.starts_with(start))
}

/// What the numbers of an output are: as it is said, else by its name, else discrete where there is a mask for them.
pub(super) fn role(
    output: &Value,
    said: Option<Kind>,
    choice_of: Option<usize>,
    masks: &[&Value],
) -> OutputRole {
    let name = output.name.to_lowercase();
    let last = output.last_size().unwrap_or(1);
    let all = output.shape.iter().flatten().product();
    let is_masked = || masks.iter().any(|mask| mask.last_size() == Some(last));
    if let Some(actions) = choice_of {
        return OutputRole::Discrete(actions);
    }
    let kind = said.unwrap_or(match () {
        () if !output.kind.is_some_and(ValueType::is_float) => Kind::Continuous,
        () if name.starts_with('q') || name.contains("logits") => Kind::Discrete,
        () if name.starts_with("action") => Kind::Continuous,
        () if is_masked() => Kind::Discrete,
        () => Kind::Continuous,
    });
    match kind {
        Kind::Discrete => OutputRole::Discrete(last),
        Kind::Continuous => OutputRole::Continuous(all),
    }
}
