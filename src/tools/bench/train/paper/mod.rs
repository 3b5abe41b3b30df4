//! Preset `paper`: CPU-seconds of both levels' steps, and the same steps in PyTorch.

mod learning;
mod torch;

use std::path::PathBuf;
use std::time::Instant;

use sortie_cli::failure::Failure;

use super::super::{Figures, Measuring, pin};
use super::{Arithmetic, TrainArguments, at, find, peak_gflops, peak_row, row, times};
use learning::{Call, Levels};
use torch::{Formulation, Torch};

/// Rounds that are measured however little time there is.
const LEAST_ROUNDS: usize = 3;
/// CPU-seconds for the machine's peak in every round.
const PEAK_S: f64 = 0.1;

/// One step again and again.
struct Case {
    name: String,
    calls: Vec<Call>,
    /// CPU-seconds of the peer, by formulation.
    peers: [Vec<f64>; 2],
}

/// What rounds found.
struct Rounds {
    low_level: Case,
    allocation: Case,
    /// Environment steps and CPU-seconds of every round's roll-out.
    played: Vec<(f64, f64)>,
    peaks: Vec<f64>,
}

pub(super) fn measure(arguments: &TrainArguments) -> Result<Figures, Failure> {
    let Measuring { common, seconds, .. } = arguments.measuring;
    let python = find(arguments.python.as_deref(), common.quiet)?;
    pin(arguments.measuring.pin)?;
    let mut levels = Levels::new(&arguments.assignments, common.seed)?;
    let start = |python: PathBuf| Torch::start(&python, &mut levels, common.quiet);
    let (mut torch, found) = match python.map(start).transpose()? {
        Some((torch, found)) => (Some(torch), found),
        None => (None, torch::compute(&mut levels, None)?),
    };
    let mut rounds = Rounds {
        low_level: Case::new(format!("low level's step, {} team values", found.terms)),
        allocation: Case::new(format!("allocation step, {} decisions", found.rows)),
        played: Vec::new(),
        peaks: Vec::new(),
    };
    // The first round fills caches and buffers.
    rounds.turn(&mut levels, torch.as_mut())?;
    rounds.clear();
    let since = Instant::now();
    while rounds.played.len() < LEAST_ROUNDS || since.elapsed().as_secs_f64() < seconds {
        rounds.turn(&mut levels, torch.as_mut())?;
    }
    Ok(rounds.figures(levels.episodes(), torch.as_ref().map(|torch| torch.version.as_str())))
}

impl Case {
    fn new(name: String) -> Self {
        Self { name, calls: Vec::new(), peers: Default::default() }
    }

    fn cpu_s(&self) -> Vec<f64> {
        self.calls.iter().map(|call| call.cpu_s).collect()
    }

    /// This step and another, one after the other.
    fn and(&self, other: &Self, name: &str) -> Self {
        let calls = self.calls.iter().zip(&other.calls).map(|(a, b)| Call {
            cpu_s: a.cpu_s + b.cpu_s,
            operations: a.operations + b.operations,
        });
        let sum = |how: usize| {
            let both = self.peers[how].iter().zip(&other.peers[how]);
            both.map(|(a, b)| a + b).collect()
        };
        Self { name: name.to_string(), calls: calls.collect(), peers: [sum(0), sum(1)] }
    }

    /// Medians of the arithmetic against the machine's peak.
    fn arithmetic(&self, peak: f64) -> Arithmetic {
        let of =
            |figure: fn(&Call) -> f64| at(&self.calls.iter().map(figure).collect::<Vec<_>>(), 0.5);
        let gflop_per_cpu_s = of(|call| call.operations / call.cpu_s / 1e9);
        Arithmetic {
            case: self.name.clone(),
            mflop: of(|call| call.operations / 1e6),
            gflop_per_cpu_s,
            share_of_peak: gflop_per_cpu_s / peak,
        }
    }
}

impl Rounds {
    /// Everything once, the peer directly behind ours.
    fn turn(&mut self, levels: &mut Levels, torch: Option<&mut Torch>) -> Result<(), Failure> {
        self.peaks.push(peak_gflops(PEAK_S));
        self.low_level.calls.push(levels.low_level_step());
        self.allocation.calls.push(levels.allocation_step());
        if let Some(torch) = torch {
            for (place, how) in Formulation::ALL.into_iter().enumerate() {
                let [low_level, allocation] = torch.turn(how)?;
                self.low_level.peers[place].push(low_level);
                self.allocation.peers[place].push(allocation);
            }
        }
        self.played.push(levels.play()?);
        Ok(())
    }

    fn clear(&mut self) {
        for case in [&mut self.low_level, &mut self.allocation] {
            case.calls.clear();
            case.peers.iter_mut().for_each(Vec::clear);
        }
        self.played.clear();
        self.peaks.clear();
    }

    /// `episodes` are those of a round of learning, and how many pairs of steps follow them.
    fn figures(&self, episodes: usize, torch: Option<&str>) -> Figures {
        let pair = self.low_level.and(&self.allocation, "both steps");
        let peak = self.peaks.iter().copied().fold(0.0, f64::max);
        let mut figures = Figures::default();
        for case in [&self.low_level, &self.allocation, &pair] {
            figures.rows.push(times(
                &case.name,
                "sortie",
                env!("CARGO_PKG_VERSION"),
                &case.cpu_s(),
            ));
            figures.arithmetic.push(case.arithmetic(peak));
            for (how, peers) in Formulation::ALL.into_iter().zip(&case.peers) {
                let Some(version) = torch else { continue };
                figures.rows.push(times(&case.name, how.engine(), version, peers));
                let engines = ["sortie", how.engine()];
                figures.add_ratio("train", &case.name, engines, [&case.cpu_s(), peers]);
            }
        }
        let version = env!("CARGO_PKG_VERSION");
        let played: Vec<f64> = self.played.iter().map(|(_, cpu_s)| *cpu_s).collect();
        let name = format!("roll-out of {episodes} episodes");
        figures.rows.push(times(&name, "sortie", version, &played));
        let whole = self.played.iter().zip(pair.cpu_s());
        let rates: Vec<f64> =
            whole.map(|((steps, cpu_s), pair)| steps / (cpu_s + episodes as f64 * pair)).collect();
        let name = format!("a round: roll-out, then both steps {episodes} times");
        figures.rows.push(row(
            &name,
            "sortie",
            version,
            &rates,
            "environment steps per CPU-second",
        ));
        figures.rows.push(peak_row(&self.peaks));
        figures
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(calls: &[(f64, f64)], peer: &[f64]) -> Case {
        let call =
            |(cpu_s, operations): &(f64, f64)| Call { cpu_s: *cpu_s, operations: *operations };
        let calls = calls.iter().map(call).collect();
        Case { name: "step".to_string(), calls, peers: [peer.to_vec(), Vec::new()] }
    }

    #[test]
    fn both_steps_are_added_round_by_round() {
        let low_level = case(&[(1.0, 2e9), (3.0, 2e9)], &[10.0, 30.0]);
        let pair = low_level.and(&case(&[(0.5, 1e9), (0.5, 1e9)], &[1.0, 2.0]), "both");
        assert_eq!(pair.cpu_s(), [1.5, 3.5]);
        assert_eq!(pair.peers, [vec![11.0, 32.0], vec![]]);
        assert_eq!(pair.arithmetic(2.0).mflop, 3000.0);
    }

    #[test]
    fn figures_are_medians() {
        let case = case(&[(1.0, 2e9), (8.0, 2e9), (2.0, 2e9)], &[]);
        let Arithmetic { gflop_per_cpu_s, share_of_peak, .. } = case.arithmetic(4.0);
        assert_eq!((gflop_per_cpu_s, share_of_peak), (1.0, 0.25));
    }
}
