//! What is said on the command line about a policy that somebody else exported.

use clap::Args;
use sortie_plans::PolicyOptions;

/// What runs such policies.
pub(crate) const ENGINE: &str = "tract: allocates, no promise about bits or time";

/// What is what in a policy's file, where it cannot be found or is found wrongly.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Policies of others")]
pub(crate) struct PolicyArguments {
    /// An output that is wanted, once for each; `NAME:discrete` or `NAME:continuous` also says what its numbers are
    #[arg(long = "output", value_name = "NAME")]
    outputs: Vec<String>,
    /// A size that the file leaves open, once for each; a batch is 1
    #[arg(long = "size", value_name = "NAME=N", value_parser = size)]
    sizes: Vec<(String, usize)>,
    /// A recurrent state by its input and its output, once for each; `none` if there is none
    #[arg(long = "state", value_name = "IN:OUT")]
    states: Vec<String>,
    /// The input that says which actions are available; `none` if none does
    #[arg(long, value_name = "NAME")]
    available: Option<String>,
}

impl PolicyArguments {
    pub(crate) fn options(&self) -> PolicyOptions {
        let Self { outputs, sizes, states, available } = self.clone();
        PolicyOptions { outputs, sizes, states, available }
    }
}

fn size(text: &str) -> Result<(String, usize), String> {
    let (name, size) = text.rsplit_once('=').ok_or("expected NAME=N")?;
    match size.parse() {
        Ok(size @ 1..) => Ok((name.to_owned(), size)),
        _ => Err("expected a whole number from 1 behind `=`".to_owned()),
    }
}
