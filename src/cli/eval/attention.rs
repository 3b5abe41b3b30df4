//! Whom the critics of a team look at while it plays (dissertation figure 3.5).

use std::collections::BTreeMap;

use serde::Serialize;
use sortie_envs::{EntitySet, Spec};
use sortie_learn::{Act, Ask, LearnError, Thought};

use crate::output::{Table, say};

/// A team whose critics' attention is summed up at every step.
pub(super) struct Watching<'a> {
    team: &'a mut dyn Act,
    looks: BTreeMap<(usize, Option<usize>), Looks>,
    companions: Vec<EntitySet>,
}

/// Sums over the steps in which an agent had one companion.
#[derive(Clone, Debug, Default)]
struct Looks {
    steps: u64,
    /// `[A]`: weights, means over heads.
    weights: Vec<f64>,
    /// By heads.
    entropy: Vec<f64>,
}

/// Whom critics look at, means over steps.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Attention {
    /// Role and number of each.
    agents: Vec<String>,
    /// `[A][A]`: weights that the critic of one gives the others, means over heads.
    weights: Vec<Vec<f64>>,
    /// `[A][heads]`: how evenly, in nats; ln(A - 1) where all count the same.
    entropy: Vec<Vec<f64>>,
    /// The same for each that truly belongs with an agent, where there is such truth.
    by_companion: Vec<OfCompanion>,
    #[serde(skip)]
    roles: Vec<&'static str>,
}

/// What an agent's critic looks at while it has this companion.
#[derive(Debug, PartialEq, Serialize)]
struct OfCompanion {
    agent: usize,
    companion: usize,
    steps: u64,
    weights: Vec<f64>,
}

impl<'a> Watching<'a> {
    pub(super) fn new(team: &'a mut dyn Act) -> Self {
        Self { team, looks: BTreeMap::new(), companions: Vec::new() }
    }

    pub(super) fn team(&mut self) -> &mut dyn Act {
        self.team
    }

    /// What was seen; nothing where critics look at nobody in particular.
    pub(super) fn attention(&self, spec: &Spec) -> Option<Attention> {
        let agents = 0..spec.shape.agents;
        let role = |agent| spec.role_of(agent).map_or("agent", |role| role.name);
        let all = |agent: usize| {
            let own = self.looks.range((agent, None)..=(agent, Some(usize::MAX)));
            own.fold(Looks::default(), |sum, (_, looks)| sum.plus(looks))
        };
        let sums: Vec<Looks> = agents.clone().map(all).collect();
        let of_companion = |(&(agent, companion), looks): (&(usize, _), &Looks)| {
            let (steps, weights) = (looks.steps, looks.mean(&looks.weights));
            Some(OfCompanion { agent, companion: companion?, steps, weights })
        };
        (!self.looks.is_empty()).then(|| Attention {
            agents: agents.clone().map(|agent| format!("{} {agent}", role(agent))).collect(),
            weights: sums.iter().map(|looks| looks.mean(&looks.weights)).collect(),
            entropy: sums.iter().map(|looks| looks.mean(&looks.entropy)).collect(),
            by_companion: self.looks.iter().filter_map(of_companion).collect(),
            roles: agents.map(role).collect(),
        })
    }

    fn note(&mut self, agent: usize, thought: &Thought) {
        let Some(heads) = thought.attention.first().map(|(_, weights)| weights.len()) else {
            return;
        };
        let others = self.companions.get(agent).map_or(0, |set| set & !(1 << agent));
        let companion = (others.count_ones() == 1).then(|| others.trailing_zeros() as usize);
        let looks = self.looks.entry((agent, companion)).or_default();
        looks.steps += 1;
        looks.weights.resize(self.companions.len(), 0.0);
        looks.entropy.resize(heads, 0.0);
        for (other, weights) in &thought.attention {
            for (weight, entropy) in weights.iter().zip(&mut looks.entropy) {
                let weight = f64::from(*weight);
                looks.weights[*other] += weight / heads as f64;
                *entropy -= if weight > 0.0 { weight * weight.ln() } else { 0.0 };
            }
        }
    }
}

impl Act for Watching<'_> {
    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>) -> Result<(), LearnError> {
        self.team.act(Ask { scenes, random, actions })?;
        let agents = scenes.environment.spec().shape.agents;
        let thoughts = self.team.thoughts(scenes, actions);
        for (scene, thoughts) in scenes.scenes.iter().zip(thoughts.chunks(agents)) {
            self.companions.clear();
            self.companions.resize(agents, 0);
            if !scenes.environment.companions(scene.state, &mut self.companions) {
                self.companions.fill(0);
            }
            thoughts.iter().enumerate().for_each(|(agent, thought)| self.note(agent, thought));
        }
        Ok(())
    }
}

impl Looks {
    fn plus(mut self, other: &Self) -> Self {
        let add = |to: &mut Vec<f64>, from: &[f64]| {
            to.resize(from.len(), 0.0);
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        };
        self.steps += other.steps;
        add(&mut self.weights, &other.weights);
        add(&mut self.entropy, &other.entropy);
        self
    }

    fn mean(&self, sums: &[f64]) -> Vec<f64> {
        sums.iter().map(|sum| sum / self.steps.max(1) as f64).collect()
    }
}

impl Attention {
    /// How much the critic of one agent looks at another that is its companion, and at one that is not.
    fn split(&self, agent: usize, other: usize) -> [Option<f64>; 2] {
        let mean = |is_companion: bool| {
            let parts = self.by_companion.iter().filter(|part| part.agent == agent);
            let parts = parts.filter(|part| (part.companion == other) == is_companion);
            let (sum, steps) = parts.fold((0.0, 0), |(sum, steps), part| {
                (sum + part.weights[other] * part.steps as f64, steps + part.steps)
            });
            (steps > 0).then(|| sum / steps as f64)
        };
        if self.by_companion.is_empty() {
            return [None, Some(self.weights[agent][other])];
        }
        [true, false].map(mean)
    }

    pub(super) fn print(&self) {
        let splits = !self.by_companion.is_empty();
        say!();
        say!(
            "attention of critics (rows), mean over heads and steps{}",
            if splits { ": of a companion / of another" } else { "" }
        );
        let numbers: Vec<String> = (0..self.agents.len()).map(|agent| agent.to_string()).collect();
        let header = [&["agent".to_owned()][..], &numbers, &["entropy".to_owned()]].concat();
        let header: Vec<&str> = header.iter().map(String::as_str).collect();
        let mut table = Table::new(&header);
        for (agent, name) in self.agents.iter().enumerate() {
            let cell = |other: usize| match self.split(agent, other) {
                _ if other == agent => "-".to_owned(),
                [Some(one), Some(another)] => format!("{one:.3} / {another:.3}"),
                [one, another] => one.or(another).map_or(String::new(), |one| format!("{one:.3}")),
            };
            let cells = (0..self.agents.len()).map(cell);
            let entropy =
                self.entropy[agent].iter().sum::<f64>() / self.entropy[agent].len() as f64;
            let entropy = format!("{entropy:.3}");
            table.row([name.clone()].into_iter().chain(cells).chain([entropy]));
        }
        table.print();
        if splits {
            self.print_roles();
        }
    }

    /// What companions and others get, by roles.
    fn print_roles(&self) {
        say!();
        let mut table =
            Table::new(&["role", "companion", "each other of its role", "each of the own role"]);
        let mut roles = self.roles.clone();
        roles.dedup();
        for role in roles {
            let pairs = || {
                let agents = 0..self.agents.len();
                let own = agents.clone().filter(|agent| self.roles[*agent] == role);
                own.flat_map(move |agent| agents.clone().map(move |other| (agent, other)))
            };
            let mean = |is_own: bool, part: usize| {
                let pairs = pairs().filter(|(agent, other)| agent != other);
                let pairs = pairs.filter(|(_, other)| (self.roles[*other] == role) == is_own);
                let found: Vec<f64> =
                    pairs.filter_map(|(agent, other)| self.split(agent, other)[part]).collect();
                match found.len() {
                    0 => "-".to_owned(),
                    count => format!("{:.3}", found.iter().sum::<f64>() / count as f64),
                }
            };
            table.row([role.to_owned(), mean(false, 0), mean(false, 1), mean(true, 1)]);
        }
        table.print();
    }
}
