//! What is said on the command line about a policy that somebody else exported.

use std::path::{Path, PathBuf};

use clap::Args;
use sortie_bundle::PolicyRoles;
use sortie_bundle::files::{MOST_TEXT_BYTES, read_file};
use sortie_plans::PolicyOptions;

use crate::failure::{Exit, Failure};

/// What runs such policies.
pub const ENGINE: &str = "tract: allocates, no promise about bits or time";

/// What is what in a policy's file, where it cannot be found or is found wrongly.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Policies of others")]
pub struct PolicyArguments {
    /// An output that is wanted, once for each; `NAME:discrete` or `NAME:continuous` also says what its numbers are
    #[arg(long = "output", value_name = "NAME")]
    outputs: Vec<String>,
    /// A size that the file leaves open, once for each; a batch is 1. `INPUT.0=1` where the file fixes it at more
    #[arg(long = "size", value_name = "NAME=N", value_parser = size)]
    sizes: Vec<(String, usize)>,
    /// A recurrent state by its input and its output, once for each; `none` if there is none
    #[arg(long = "state", value_name = "IN:OUT")]
    states: Vec<String>,
    /// The input that says which actions are available; `none` if none does
    #[arg(long, value_name = "NAME")]
    available: Option<String>,
    /// The input that holds the entities [1, N, D] of a team
    #[arg(long, value_name = "NAME")]
    entities: Option<String>,
    /// The input that says which entities an agent may attend to: those where it is 1, or where it is 0
    #[arg(long, value_name = "NAME:visible|blocked")]
    mask: Option<String>,
    /// Which entity the agent itself is: `first`, or the input with its number
    #[arg(long = "self", value_name = "first|NAME")]
    own: Option<String>,
    /// All of this as TOML, keys named like the flags, which win [default: the file beside the ONNX file, `policy.toml`
    /// beside `policy.onnx`]
    #[arg(long, value_name = "FILE")]
    contract: Option<PathBuf>,
}

impl PolicyArguments {
    pub fn options(&self) -> PolicyOptions {
        let Self { outputs, sizes, states, available, entities, mask, own, .. } = self.clone();
        PolicyOptions { outputs, sizes, states, available, entities, mask, own }
    }

    /// What is said of an ONNX file: by flags, else by the file that `--contract` names, else by the one beside it.
    pub fn options_for(&self, onnx: &Path) -> Result<PolicyOptions, Failure> {
        let beside = onnx.with_extension("toml");
        let file = match &self.contract {
            Some(file) => file,
            None if onnx.is_file() && beside.is_file() => &beside,
            None => return Ok(self.options()),
        };
        let text = read_file(file, MOST_TEXT_BYTES).map_err(|error| Failure::file(file, &error))?;
        let roles = PolicyRoles::from_toml(&text)
            .map_err(|reason| Failure::new(Exit::BadData, reason).within(file.display()))?;
        let (said, written) = (self.options(), PolicyOptions::from(roles));
        let names = |said: Vec<String>, written| if said.is_empty() { written } else { said };
        Ok(PolicyOptions {
            outputs: names(said.outputs, written.outputs),
            sizes: if said.sizes.is_empty() { written.sizes } else { said.sizes },
            states: names(said.states, written.states),
            available: said.available.or(written.available),
            entities: said.entities.or(written.entities),
            mask: said.mask.or(written.mask),
            own: said.own.or(written.own),
        })
    }
}

fn size(text: &str) -> Result<(String, usize), String> {
    let (name, size) = text.rsplit_once('=').ok_or("expected NAME=N")?;
    match size.parse() {
        Ok(size @ 1..) => Ok((name.to_owned(), size)),
        _ => Err("expected a whole number from 1 behind `=`".to_owned()),
    }
}
