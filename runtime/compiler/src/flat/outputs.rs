//! Which outputs are wanted, and what their numbers are.

use sortie_plans::{CompileError, OutputRole, ValueType};

use super::drawn::LIKELIEST;
use super::values::{Value, listed};

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
            [_] => return Ok(taken(&found)),
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
