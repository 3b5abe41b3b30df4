//! Games of milestones as they are shown: the map, what is carried, and what an agent that runs options thinks.

use std::marker::PhantomData;

use sortie_bundle::{Bundle, OptionsContract};
use sortie_core::Policy;
use sortie_core::options::{OptionPolicy, PlanNetworks, Pursuit};
use sortie_core::plan::Profile;
use sortie_envs::{Environment, Split};
use sortie_learn::draft::DecoratedPolicy;
use sortie_learn::play::PolicyTeam;
use sortie_plans::{CompileError, option_arena, option_networks, option_policy};
use sortie_stage::milestones::{Board, KnownGame};
use sortie_stage::{Pursued, Show, Thought, rounded};

use super::live::live;
use super::page::{Deeds, Web, page, script, style};
use super::{Live, Page, View, Wanted, no_page};
use crate::environment::check_fits;
use crate::failure::Failure;
use crate::subject::Subject;
use crate::tools::plans;
use crate::views::captured::{self, Captured};

/// What is shown of such a game.
pub(super) struct Shown<G>(PhantomData<G>);

impl<G> Shown<G> {
    pub(super) const NEW: Self = Self(PhantomData);
}

const TRUTH: &str = "What can be reached is the environment's own answer; the agent is not told.";

const WEB: Web = Web {
    styles: &[
        style::COLOURS,
        style::BASICS,
        style::LAYOUT,
        style::DESK,
        style::RESULT,
        style::DISCS,
        include_str!("web/board.css"),
        style::LANES,
        style::PLAYBACK,
        style::AGENT,
        style::DIALOG,
    ],
    map: "Map",
    panels: include_str!("web/panels.html"),
    scripts: &[
        script::SUMS,
        script::NUMBERS,
        script::ELEMENTS,
        script::ACTS,
        include_str!("web/board.js"),
        include_str!("web/options.js"),
        script::LANES,
        include_str!("web/timeline.js"),
        script::PLAYER,
    ],
    deeds: Deeds {
        hint: "Drag the agent to another empty cell.",
        controls: "",
        keys: "",
        script: include_str!("web/deeds.js"),
    },
};

impl<G: KnownGame> View for Shown<G> {
    fn played(&self, wanted: &Wanted<'_>, subject: &Subject) -> Result<Page, Failure> {
        let set = wanted.set.clone().unwrap_or_default();
        let Subject::Bundle(bundle) = subject else { return Err(no_page(wanted)) };
        let Some(options) = bundle.options() else { return Err(no_page(wanted)) };
        if let Some(asked) = wanted.allocation {
            return Err(asked.of_no_use());
        }
        check_fits(bundle, &set)?;
        let world = set.open(Split::Test)?;
        let captured =
            capture::<Board<G>>(&*world, (wanted.seed, wanted.episode), (bundle, options))?;
        Ok(page(&WEB, wanted, (set.to_string(), vec![TRUTH]), captured))
    }

    fn live(
        &self,
        wanted: &Wanted<'_>,
        bundle: &Bundle,
        program: Option<&[u8]>,
    ) -> Result<Live, Failure> {
        live::<Board<G>>((&WEB, &[TRUTH]), wanted, bundle, program)
    }
}

/// Plays an episode of the environment, and writes down what went on in the agent.
fn capture<S: Show>(
    environment: &dyn Environment,
    episode: (u64, usize),
    (bundle, options): (&Bundle, &OptionsContract),
) -> Result<Captured<S>, Failure> {
    let found = plans().agents(bundle, Profile::Exact)?;
    let mut arena = option_arena(found.plans()).map_err(CompileError::from)?;
    let networks = option_networks(found.plans(), &mut arena);
    let networks = networks.map_err(CompileError::from)?;
    let policy = option_policy((options, environment.spec().shape.actions), networks)?;
    let mut thoughts = Vec::new();
    let mut team = PolicyTeam::new(noted(policy, &mut thoughts));
    let mut captured = captured::capture(environment, episode, &mut team)?;
    drop(team);
    captured.give_thoughts(thoughts);
    Ok(captured)
}

/// A policy whose every thought is noted.
fn noted<'a>(
    policy: OptionPolicy<PlanNetworks<'a>, Vec<f32>>,
    thoughts: &'a mut Vec<Thought>,
) -> impl Policy + 'a {
    DecoratedPolicy::new(policy, |policy, seen, hidden| {
        let mut utilities = vec![0.0; policy.actions()];
        policy.utilities_with(seen, &mut hidden.to_vec(), &mut utilities)?;
        let decision = policy.decide_with(seen, hidden)?;
        let mut likelihoods = vec![0.0; policy.rules().milestones().len()];
        policy.likelihoods(seen, &mut likelihoods)?;
        let option = Pursuit::of(hidden).map(|Pursuit { goal, steps }| Pursued {
            goal,
            step: steps,
            mask: policy.rules().mask(&likelihoods),
            likelihoods: likelihoods.into_iter().map(rounded).collect(),
        });
        let thought = Thought::new(&utilities, Vec::new());
        thoughts.push(Thought { option, ..thought });
        Ok(decision)
    })
}
