//! What agents and their heads think, for whoever looks on.

use sortie_learn::{Head, Thought};

use super::learner::{Learner, Rules};
use super::table::ACTIONS;
use crate::novelty::intrinsic::Intrinsic;
use crate::novelty::places::Place;

/// What a deployed agent thinks where it is, and what its heads would pay and do there; nothing of them where it never
/// was.
pub(super) fn thought(learner: &Learner, rules: &Rules, agent: usize, place: Place) -> Thought {
    let scores = learner.utilities(agent, Some(place), learner.deployed()).to_vec();
    let mut heads = Vec::new();
    if let Some(row) = learner.tables[agent].find(place) {
        let paid = learner.paid(rules, agent, row);
        let score = |action: usize, head| row.score(action, head, &rules.weights);
        let better = |head| {
            move |one: &usize, other: &usize| score(*one, head).total_cmp(&score(*other, head))
        };
        let deployed = learner.best_action(agent, place, learner.deployed());
        heads.extend(rules.heads.iter().enumerate().map(|(head, explores)| {
            let acts = head + 1 == rules.heads.len();
            let likes = (0..ACTIONS).rev().max_by(better(head)).unwrap_or_default() as u16;
            Head {
                name: explores.map_or("none", Intrinsic::name).to_owned(),
                pays: paid[head],
                likes: if acts { deployed } else { likes },
                acts,
            }
        }));
    }
    Thought { scores, heads, ..Thought::default() }
}
