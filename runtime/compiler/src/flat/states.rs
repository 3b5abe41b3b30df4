//! Recurrent states: an input and the output that is the next input.

use std::collections::HashSet;

use sortie_plans::CompileError;

use super::values::{Value, Values, listed};

/// Words that say which way a value goes.
const DIRECTIONS: [&str; 14] = [
    "in", "ins", "input", "inputs", "out", "outs", "output", "outputs", "new", "next", "prev",
    "previous", "last", "old",
];

/// Words of recurrent states, [`word`] applied.
const STATES: [&str; 11] =
    ["h", "c", "hidden", "cell", "state", "rnn", "gru", "lstm", "memory", "carry", "recurrent"];

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
        asked => asked.iter().map(|asked| named(values, asked)).collect::<Result<_, _>>()?,
    };
    let place = |pair: &Pair| values.inputs.iter().position(|input| input.name == pair.input);
    pairs.sort_by_key(place);
    let mut seen = HashSet::new();
    match pairs.iter().find(|pair| !(seen.insert(&pair.input) && seen.insert(&pair.output))) {
        Some(twice) => Err(unclear(format!("`{}` and `{}`", twice.input, twice.output))),
        None => Ok(pairs),
    }
}

/// The state that `IN:OUT` names; names may have colons themselves.
fn named(values: &Values, asked: &str) -> Result<Pair, CompileError> {
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
                return Err(unclear(format!("{input} may come back as {outputs}")));
            }
        }
    }
    Ok(pairs)
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
            return Err(unclear(format!("{input} may come back as {outputs}")));
        }
    }
    Ok(())
}

fn unclear(candidates: String) -> CompileError {
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
fn words(name: &str) -> Vec<String> {
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
