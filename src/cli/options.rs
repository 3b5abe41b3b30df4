//! The flags that every verb takes.

use clap::Args;

/// What every verb takes.
#[derive(Clone, Copy, Debug, Args)]
pub struct Common {
    /// Print JSON for scripts instead of text
    #[arg(long)]
    pub json: bool,
    /// Seed of every random choice
    #[arg(long, default_value_t = 1, value_parser = whole_number)]
    pub seed: u64,
    /// No progress, no notes: the result alone
    #[arg(short, long)]
    pub quiet: bool,
}

fn whole_number(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("expected a whole number from 0 to {}", u64::MAX))
}
