//! Which outputs are wanted, and what their numbers are.

use sortie_plans::{CompileError, OutputRole, ValueType};

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

/// The outputs that are asked for, in the file's order; else the one that chooses an action, else the one that is named
/// like actions or their values, else the only one. `outputs` are those that are no states.
pub(super) fn wanted(
    outputs: &[&Value],
    is_choice: impl Fn(&Value) -> bool,
    asked: &[String],
) -> Result<Vec<Wanted>, CompileError> {
    if !asked.is_empty() {
        let asked: Vec<Wanted> =
            asked.iter().map(|asked| named(outputs, asked)).collect::<Result<_, _>>()?;
        let of = |output: &&Value| asked.iter().find(|wanted| wanted.name == output.name).cloned();
        return Ok(outputs.iter().filter_map(of).collect());
    }
    let choices = outputs.iter().copied().filter(|output| is_choice(output));
    let named = |is_like: fn(&str) -> bool| -> Vec<&Value> {
        outputs.iter().copied().filter(|output| is_like(&output.name.to_lowercase())).collect()
    };
    let ways =
        [choices.collect(), named(is_without_chance), named(is_like_actions), outputs.to_vec()];
    for found in ways {
        match found.as_slice() {
            [] => {}
            [one] => return Ok(vec![Wanted { name: one.name.clone(), said: None }]),
            several => return Err(unclear(several)),
        }
    }
    Err(CompileError::NoPolicy { reason: "it has no output but recurrent states".to_owned() })
}

fn named(outputs: &[&Value], asked: &str) -> Result<Wanted, CompileError> {
    let whole = (asked, None);
    let discrete = asked.strip_suffix(":discrete").map(|name| (name, Some(Kind::Discrete)));
    let continuous = asked.strip_suffix(":continuous").map(|name| (name, Some(Kind::Continuous)));
    let mut forms = [Some(whole), discrete, continuous].into_iter().flatten();
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

/// Whether a name in small letters is one of actions, of their values or of what they are drawn around.
fn is_like_actions(name: &str) -> bool {
    name == "mu" || ["action", "q", "logits"].iter().any(|start| name.starts_with(start))
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
