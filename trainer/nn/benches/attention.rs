//! Seconds and arithmetic of the attention layers at the widths of the presets, on one thread.
//!
//! `cargo bench -p sortie-nn --bench attention -- [ROUNDS]`. Scenes of eight agents that see six of twelve entities each; a
//! round goes forward and backward once, and the fastest of all rounds counts.
#![allow(clippy::print_stdout, reason = "a program of its own")]

use std::time::{Duration, Instant};

use sortie_nn::gradient_check::random;
use sortie_nn::layers::absorbed_attention::{AbsorbedAttention, AbsorbedBackward};
use sortie_nn::layers::attention::{self, AttentionShape};
use sortie_nn::layers::team_attention::{self, Sums};
use sortie_nn::layers::{TeamLists, VisibleLists};

const SCENES: usize = 128;
const AGENTS: usize = 8;
const ENTITIES: usize = 12;
const SEEN: usize = 6;

fn main() {
    let rounds = std::env::args().filter_map(|argument| argument.parse().ok()).next();
    let rounds: usize = rounds.unwrap_or(200);
    println!("{:<10}{:>6}{:>14}{:>10}{:>10}", "layer", "width", "us a round", "MFLOP", "GFLOP/s");
    for width in [32, 64, 128] {
        let shape = AttentionShape { width, heads: 4 };
        row("keys", width, keys_values(shape), rounds);
        row("absorbed", width, absorbed(shape), rounds);
        row("teams", width, teams(shape), rounds);
    }
}

/// Prints the fastest of so many rounds of a computation of so many operations.
fn row(name: &str, width: usize, (operations, mut round): (usize, impl FnMut()), rounds: usize) {
    let fastest = (0..rounds).map(|_| {
        let start = Instant::now();
        round();
        start.elapsed()
    });
    let fastest = fastest.min().unwrap_or(Duration::MAX).as_secs_f64();
    println!(
        "{name:<10}{width:>6}{:>14.1}{:>10.2}{:>10.2}",
        1e6 * fastest,
        operations as f64 / 1e6,
        operations as f64 / fastest / 1e9
    );
}

fn visible() -> VisibleLists {
    let mut visible = VisibleLists::default();
    for scene in 0..SCENES {
        for agent in 0..AGENTS {
            (0..SEEN).for_each(|i| visible.push(scene * ENTITIES + (agent + 2 * i) % ENTITIES));
            visible.end_list();
        }
    }
    visible
}

/// Scores and sums, then four such passes backward: what pairs take, without products and softmax.
fn keys_values(shape: AttentionShape) -> (usize, impl FnMut()) {
    let (queries, rows) = (SCENES * AGENTS * shape.width, SCENES * ENTITIES * shape.width);
    let visible = visible();
    let (q, kv, d) = (random(1, queries), random(2, 2 * rows), random(3, queries));
    let mut weights = vec![0.0; visible.pairs() * shape.heads];
    let (mut out, mut d_q, mut d_kv) = (d.clone(), d.clone(), kv.clone());
    let mut d_scores = vec![0.0; SEEN * shape.heads];
    (12 * visible.pairs() * shape.width, move || {
        attention::forward(shape, &visible, &q, &kv, &mut weights, &mut out);
        let pass = attention::Backward {
            queries: &q,
            keys_values: &kv,
            weights: &weights,
            d_output: &d,
            d_scores: &mut d_scores,
            d_queries: &mut d_q,
            d_keys_values: &mut d_kv,
        };
        attention::backward(shape, &visible, pass);
    })
}

/// As above for every head over the whole width, and the six products of each head.
fn absorbed(shape: AttentionShape) -> (usize, impl FnMut()) {
    let AttentionShape { width, heads } = shape;
    let visible = visible();
    let queries = SCENES * AGENTS;
    let (q, x) = (random(1, queries * width), random(2, SCENES * ENTITIES * width));
    let (d, matrices) = (random(3, queries * width), random(4, 2 * width * width));
    let mut layer = AbsorbedAttention::default();
    let (mut out, mut d_q, mut d_x, mut d_m) = (d.clone(), d.clone(), x.clone(), matrices.clone());
    let operations = 12 * visible.pairs() * heads * width + 12 * queries * width * width;
    (operations, move || {
        layer.forward(shape, &visible, &matrices, (&q, &x), &mut out);
        d_m.fill(0.0);
        let pass = AbsorbedBackward {
            queries: &q,
            entities: &x,
            d_output: &d,
            d_queries: &mut d_q,
            d_entities: &mut d_x,
            d_keys_values: &mut d_m,
        };
        layer.backward(shape, &visible, &matrices, pass);
    })
}

/// Scores of every agent of a scene, and one sum of rows for the team.
fn teams(shape: AttentionShape) -> (usize, impl FnMut()) {
    let AttentionShape { width, heads } = shape;
    let mut teams = TeamLists::default();
    for scene in 0..SCENES {
        (0..ENTITIES).for_each(|entity| teams.push(scene * ENTITIES + entity));
        teams.end_team(AGENTS);
    }
    let (queries, rows) = (SCENES * AGENTS * width, SCENES * ENTITIES * width);
    let (q, keys, x) = (random(1, queries), random(2, rows), random(3, rows));
    let mut weights = vec![0.0; teams.pairs() * heads];
    let mut sums = random(4, Sums::PerTeam.count(&teams) * heads * width);
    let (d, mut d_q, mut d_keys, mut d_x) = (sums.clone(), q.clone(), keys.clone(), x.clone());
    let operations = 6 * teams.pairs() * width + 6 * teams.members() * heads * width;
    (operations, move || {
        let (queries, keys, rows) = (&q[..], &keys[..], &x[..]);
        let pass =
            team_attention::Forward { queries, keys, rows, weights: &mut weights, sums: &mut sums };
        team_attention::forward(shape, &teams, Sums::PerTeam, pass);
        let pass = team_attention::Backward {
            queries,
            keys,
            rows,
            weights: &weights,
            d_sums: &d,
            d_queries: &mut d_q,
            d_keys: &mut d_keys,
            d_rows: &mut d_x,
        };
        team_attention::backward(shape, &teams, Sums::PerTeam, pass);
    })
}
