//! Learns a team-value allocator for the agents of a run, one thread:
//! `cargo run --release -p sortie-learn --example team_value -- RUN SEED OUT [CONFIG.toml]`.
//!
//! Prints a JSON object per evaluation, then one for 2,000 fresh episodes, then the hand-written rules
//! on the same episodes. The averaged weights end up as the tensors `average/` of a checkpoint in OUT.

use std::path::Path;

use rustix::time::{ClockId, clock_gettime};
use serde_json::json;
use sortie_envs::save_the_city::AllocationRule;
use sortie_learn::evaluate::{NetworkTeam, evaluate};
use sortie_learn::methods::alma::team_value::{TeamValueConfig, TeamValueTrainer};
use sortie_learn::run::{Checkpoints, Run};

const FRESH_EPISODES: usize = 2_000;
const FRESH_SEED: u64 = 1_000_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (run, seed, out, config) = match arguments.as_slice() {
        [run, seed, out] => (run, seed, out, TeamValueConfig::default()),
        [run, seed, out, config] => {
            (run, seed, out, TeamValueConfig::from_toml(&std::fs::read_to_string(config)?)?)
        }
        _ => return Err("expected RUN SEED OUT [CONFIG.toml]".into()),
    };
    let agents = Run::open(Path::new(run))?.network;
    let mut trainer = TeamValueTrainer::new(config, seed.parse()?, &agents)?;
    trainer.run(|point| println!("{}", json!({ "cpu_s": cpu_s(), "point": point })))?;
    let learned_s = cpu_s();
    let plan = trainer.plan(FRESH_EPISODES, FRESH_SEED)?;
    let fresh = trainer.evaluate(&plan)?;
    println!(
        "{}",
        json!({ "cpu_s": learned_s, "evaluation_s": cpu_s() - learned_s, "fresh": fresh })
    );
    for mut rule in [AllocationRule::Coordinated, AllocationRule::Heuristic] {
        let start = cpu_s();
        let fresh = evaluate(&plan, &mut NetworkTeam::new(&agents), &mut rule)?;
        println!("{}", json!({ "rule": rule, "evaluation_s": cpu_s() - start, "fresh": fresh }));
    }
    let network = trainer.network();
    let vectors: [(&str, &[f32]); 1] = [("average", network.parameters())];
    Checkpoints::new(Path::new(out)).write(0, network.shape(), &vectors, &())?;
    Ok(())
}

/// Processor time of this process, evaluations included.
fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
