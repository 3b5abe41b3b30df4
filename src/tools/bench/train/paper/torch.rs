//! The same steps in PyTorch.

use std::path::Path;

use serde::Deserialize;

use super::super::program::{Comparison, Program};
use super::batch::{self, Found};
use super::learning::Levels;
use sortie_cli::failure::{Exit, Failure};

const PROGRAM: &str = include_str!("../../../../../benches/published_step.py");

/// A running program that waits for its turn.
pub(super) struct Torch {
    program: Program,
    version: String,
}

/// How the steps are written for PyTorch.
#[derive(Clone, Copy)]
pub(super) enum Formulation {
    /// As the public code is structured: everything padded, then masked.
    Padded,
    /// Only what the loss depends on.
    Lean,
}

impl Formulation {
    pub(super) const ALL: [Self; 2] = [Self::Padded, Self::Lean];

    /// Its name as a peer.
    pub(super) fn engine(self) -> &'static str {
        match self {
            Self::Padded => "pytorch, padded",
            Self::Lean => "pytorch, lean",
        }
    }

    /// Its name in the program.
    fn name(self) -> &'static str {
        match self {
            Self::Padded => "padded",
            Self::Lean => "lean",
        }
    }
}

/// What the program says once it is ready.
#[derive(Deserialize)]
struct Ready {
    torch: String,
    padded: Levelled,
    lean: Levelled,
}

/// The gradients of one formulation.
#[derive(Deserialize)]
struct Levelled {
    online: Comparison,
    critic: Comparison,
    policy: Comparison,
}

#[derive(Deserialize)]
struct Turn {
    cpu_s: f64,
}

impl Torch {
    /// Starts the program and compares both steps with ours.
    pub(super) fn start(
        python: &Path,
        levels: &mut Levels,
        quiet: bool,
    ) -> Result<(Self, Found), Failure> {
        let mut ours = None;
        let write = |path: &Path| {
            ours = Some(batch::compute(levels, Some(path))?);
            Ok(())
        };
        let (program, ready) = Program::start::<Ready>(python, PROGRAM, &[], write)?;
        let ours =
            ours.ok_or_else(|| Failure::new(Exit::Bug, "the PyTorch program got no batch"))?;
        for (formulation, found) in Formulation::ALL.iter().zip([&ready.padded, &ready.lean]) {
            let engine = formulation.engine();
            found.online.check((engine, "agents and mixer"), ours.low_level, quiet)?;
            found.critic.check((engine, "the allocation critic"), ours.critic, quiet)?;
            found.policy.check((engine, "the proposal policy"), ours.policy, quiet)?;
        }
        Ok((Self { program, version: ready.torch }, ours))
    }

    /// Version of torch.
    pub(super) fn version(&self) -> &str {
        &self.version
    }

    /// CPU-seconds of one step of each level.
    pub(super) fn turn(&mut self, how: Formulation) -> Result<[f64; 2], Failure> {
        let mut step = |level: &str| -> Result<f64, Failure> {
            let turn: Turn = self.program.ask(&format!("{} {level}", how.name()))?;
            Ok(turn.cpu_s)
        };
        Ok([step("low_level")?, step("allocation")?])
    }
}
