//! Why an episode failed: one cause, read off its states as it is played.
//!
//! A lost building comes before a time-out, because from then on the episode cannot be solved. The
//! causes are tried in the order of [`Cause::ALL`]; the last one of either kind takes the rest, so that
//! every failed episode has exactly one.

use alloc::vec::Vec;

use super::rules::{Bounce, Constants, FREEZE, can_approach};
use super::state::{AgentKind, AgentState, BuildingState, City, Status};

/// Why an episode was not solved.
///
/// A *capable* team is what can put out a fire: a firefighter, or a builder with a generalist. *At the
/// end* means in at least half of the last 32 steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The first building that burned down had a capable team assigned for at most a fifth of its fire.
    BurnedUnattended,
    /// When its fire was first seen, no capable team could get there in the time that a full fire needs.
    BurnedOutOfReach,
    /// A capable team was sent, but came too late, was withdrawn, or did something else.
    BurnedLate,
    /// At the end an open building burned, was protected from damage, and its fire did not shrink.
    TimeoutFreezing,
    /// At the end some building gained health, so that more time would have helped.
    TimeoutSlowWork,
    /// At the end an agent away from its building lost its cell to another or had no move that leads nearer.
    TimeoutBlocked,
    /// Nothing of this: agents stood still, wandered, or were sent to and fro.
    TimeoutIdle,
}

impl Cause {
    /// The names of all.
    pub(super) const NAMES: [&str; 7] = {
        let mut names = [""; 7];
        let mut place = 0;
        while place < names.len() {
            names[place] = Self::ALL[place].name();
            place += 1;
        }
        names
    };

    /// All causes, in the order in which they are tried.
    pub const ALL: [Self; 7] = [
        Self::BurnedUnattended,
        Self::BurnedOutOfReach,
        Self::BurnedLate,
        Self::TimeoutFreezing,
        Self::TimeoutSlowWork,
        Self::TimeoutBlocked,
        Self::TimeoutIdle,
    ];

    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::BurnedUnattended => "burned_unattended",
            Self::BurnedOutOfReach => "burned_out_of_reach",
            Self::BurnedLate => "burned_late",
            Self::TimeoutFreezing => "timeout_freezing",
            Self::TimeoutSlowWork => "timeout_slow_work",
            Self::TimeoutBlocked => "timeout_blocked",
            Self::TimeoutIdle => "timeout_idle",
        }
    }
}

/// The last 32 steps, a bit each, the newest lowest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Recent(u32);

impl Recent {
    fn push(&mut self, holds: bool) {
        self.0 = self.0 << 1 | u32::from(holds);
    }

    fn mostly(self) -> bool {
        self.0.count_ones() >= u32::BITS / 2
    }
}

/// The last fire of a building.
#[derive(Clone, Copy, Debug, Default)]
struct Fire {
    /// Steps that it has burned.
    steps: u32,
    /// Those with a capable team assigned.
    attended: u32,
    out_of_reach: bool,
}

/// What a team did in a step, and where it led.
#[derive(Clone, Copy, Debug)]
pub(super) struct Done<'a> {
    /// Agents and buildings after the step.
    pub(super) city: City<'a>,
    /// The building that each agent acted for.
    pub(super) allocation: &'a [u8],
    /// What each agent did.
    pub(super) actions: &'a [u16],
    /// The collisions of the step.
    pub(super) bounces: &'a [Bounce],
}

/// Follows one episode.
#[derive(Clone, Debug, Default)]
pub(super) struct CauseFinder {
    /// The state before the next step.
    agents: Vec<AgentState>,
    buildings: Vec<BuildingState>,
    fires: Vec<Fire>,
    freezing: Vec<Recent>,
    blocked: Vec<Recent>,
    working: Recent,
    burned: Option<Cause>,
}

impl CauseFinder {
    /// Forgets the episode before; the new one shows its first state.
    pub(super) fn begin(&mut self, city: City<'_>) {
        self.keep(city);
        reset(&mut self.fires, city.buildings.len());
        reset(&mut self.freezing, city.buildings.len());
        reset(&mut self.blocked, city.agents.len());
        self.working = Recent::default();
        self.burned = None;
    }

    fn keep(&mut self, city: City<'_>) {
        self.agents.clear();
        self.agents.extend_from_slice(city.agents);
        self.buildings.clear();
        self.buildings.extend_from_slice(city.buildings);
    }

    /// A step was taken.
    pub(super) fn stepped(&mut self, constants: &Constants, after: Done<'_>) {
        let mut working = false;
        for (task, building) in after.city.buildings.iter().enumerate() {
            let before = self.buildings[task];
            if before.is_open() {
                self.follow_fire(constants, after, task);
                let frozen = self.is_frozen(after, task);
                self.freezing[task].push(frozen);
                working |= building.health > before.health;
            }
        }
        self.working.push(working);
        for agent in 0..self.agents.len() {
            let blocked = self.is_blocked(after, agent);
            self.blocked[agent].push(blocked);
        }
        self.keep(after.city);
    }

    /// Why the episode that has just ended failed.
    pub(super) fn cause(&self, solved: bool) -> Option<Cause> {
        if solved {
            return None;
        }
        let open = self.buildings.iter().zip(&self.freezing).filter(|(b, _)| b.is_open());
        self.burned.or(Some(if open.into_iter().any(|(_, freezing)| freezing.mostly()) {
            Cause::TimeoutFreezing
        } else if self.working.mostly() {
            Cause::TimeoutSlowWork
        } else if self.blocked.iter().any(|blocked| blocked.mostly()) {
            Cause::TimeoutBlocked
        } else {
            Cause::TimeoutIdle
        }))
    }

    fn follow_fire(&mut self, constants: &Constants, after: Done<'_>, task: usize) {
        let (before, fire) = (&self.buildings[task], &mut self.fires[task]);
        if !before.is_burning() {
            *fire = Fire::default();
        } else {
            if fire.steps == 0 {
                fire.out_of_reach = is_out_of_reach(constants, &self.agents, before);
            }
            let team = self.agents.iter().zip(after.allocation);
            let team = team.filter(|(_, own)| usize::from(**own) == task);
            fire.steps += 1;
            fire.attended += u32::from(is_capable(team.map(|(agent, _)| agent.kind)));
        }
        if after.city.buildings[task].status == Status::BurnedDown {
            self.burned.get_or_insert(if 5 * fire.attended <= fire.steps {
                Cause::BurnedUnattended
            } else if fire.out_of_reach {
                Cause::BurnedOutOfReach
            } else {
                Cause::BurnedLate
            });
        }
    }

    fn is_frozen(&self, after: Done<'_>, task: usize) -> bool {
        let before = &self.buildings[task];
        let freezes = |(agent, action): (&AgentState, &u16)| {
            usize::from(agent.beside) == task && *action == FREEZE
        };
        before.is_burning()
            && after.city.buildings[task].fire >= before.fire
            && self.agents.iter().zip(after.actions).any(freezes)
    }

    fn is_blocked(&self, after: Done<'_>, agent: usize) -> bool {
        let task = after.allocation[agent];
        let Some(building) = self.buildings.get(usize::from(task)) else { return false };
        let before = &self.agents[agent];
        let nearer = after.city.agents[agent].distance_to(building) < before.distance_to(building);
        !nearer
            && before.beside != task
            && (after.bounces.iter().any(|bounce| usize::from(bounce.loser) == agent)
                || !can_approach(before, building))
    }
}

/// Refills with defaults.
fn reset<T: Copy + Default>(list: &mut Vec<T>, length: usize) {
    list.clear();
    list.resize(length, T::default());
}

fn is_capable(kinds: impl Iterator<Item = AgentKind>) -> bool {
    let present = kinds.fold([false; 3], |mut present, kind| {
        present[kind as usize] = true;
        present
    });
    let [firefighter, builder, generalist] = present;
    firefighter || (builder && generalist)
}

/// Whether the building burns down, at full fire, before any capable team can stand beside it.
fn is_out_of_reach(constants: &Constants, agents: &[AgentState], building: &BuildingState) -> bool {
    let nearest = |kind| {
        let times = agents.iter().filter(|agent| agent.kind == kind);
        times.map(|agent| agent.travel_time_to(building)).fold(f64::INFINITY, f64::min)
    };
    let pair = nearest(AgentKind::Builder).max(nearest(AgentKind::Generalist));
    let life = building.health / (building.kind.burn_rate() * constants.fire_burn_rate);
    nearest(AgentKind::Firefighter).min(pair) >= life
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;

    use super::super::rules::ACTIONS;
    use super::super::state::BuildingKind;
    use crate::decisions::UNASSIGNED;

    const NORTH: u16 = 1;

    fn building(health: f64, fire: f64) -> BuildingState {
        BuildingState {
            health,
            fire,
            period: 70,
            to_next_fire: 60,
            since_last_fire: 10,
            kind: BuildingKind::Fast,
            status: Status::of_health(health),
            x: 4,
            y: 4,
        }
    }

    /// An agent below the building that may do everything.
    fn agent(kind: AgentKind, y: u8) -> AgentState {
        let beside = if y == 3 { 0 } else { u8::MAX };
        AgentState { beside, available: (1 << ACTIONS) - 1, ..AgentState::at(kind, 4, y) }
    }

    /// Follows one building through `states`, under one allocation and with one action for all.
    fn cause(
        agents: &[AgentState],
        states: &[BuildingState],
        allocation: &[u8],
        action: u16,
        bounces: &[Bounce],
    ) -> Option<Cause> {
        let mut finder = CauseFinder::default();
        let actions = vec![action; agents.len()];
        finder.begin(City { agents, buildings: &states[..1] });
        for state in states.windows(2) {
            let city = City { agents, buildings: &state[1..] };
            let done = Done { city, allocation, actions: &actions, bounces };
            finder.stepped(&Constants::default(), done);
        }
        finder.cause(false)
    }

    #[test]
    fn a_lost_building_is_told_by_who_was_sent_and_how_far_it_was() {
        let burning = |health| {
            let mut states = vec![building(health, 1.0); 10];
            states.push(building(0.0, 0.0));
            states
        };
        let cause = |kinds: &[AgentKind], y, health, task| {
            let agents: Vec<_> = kinds.iter().map(|kind| agent(*kind, y)).collect();
            cause(&agents, &burning(health), &vec![task; agents.len()], 0, &[]).unwrap()
        };
        use AgentKind::{Builder, Firefighter, Generalist};
        assert_eq!(cause(&[Firefighter], 3, 0.5, 1), Cause::BurnedUnattended);
        assert_eq!(cause(&[Builder], 3, 0.5, 0), Cause::BurnedUnattended, "cannot fight");
        assert_eq!(cause(&[Builder, Generalist], 3, 0.5, 0), Cause::BurnedLate);
        assert_eq!(cause(&[Firefighter], 3, 0.5, 0), Cause::BurnedLate);
        // Full fire takes 0.035 a step: nine steps are too many, and a builder is as slow.
        assert_eq!(cause(&[Firefighter], 14, 0.3, 0), Cause::BurnedOutOfReach);
        assert_eq!(cause(&[Builder, Generalist], 14, 0.3, 0), Cause::BurnedOutOfReach);
    }

    #[test]
    fn a_timeout_is_told_by_the_last_steps() {
        use AgentKind::{Firefighter, Generalist};
        let still = vec![building(0.5, 0.0); 40];
        let growing: Vec<_> =
            (0..40).map(|step| building(0.1 + 0.01 * f64::from(step), 0.0)).collect();
        let burning = vec![building(0.5, 1.0); 40];
        let bounce = [Bounce { first: 0, second: 1, loser: 0 }];
        let boxed_in = AgentState { available: 1, ..agent(Firefighter, 9) };

        let generalist = [agent(Generalist, 3)];
        assert_eq!(cause(&generalist, &burning, &[0], 11, &[]), Some(Cause::TimeoutFreezing));
        assert_eq!(cause(&generalist, &burning, &[0], 9, &[]), Some(Cause::TimeoutIdle));
        assert_eq!(
            cause(&[agent(Firefighter, 3)], &growing, &[0], 10, &[]),
            Some(Cause::TimeoutSlowWork)
        );
        let far = [agent(Firefighter, 9)];
        assert_eq!(cause(&far, &still, &[0], NORTH, &bounce), Some(Cause::TimeoutBlocked));
        assert_eq!(cause(&[boxed_in], &still, &[0], 0, &[]), Some(Cause::TimeoutBlocked));
        assert_eq!(cause(&far, &still, &[0], NORTH, &[]), Some(Cause::TimeoutIdle));
        assert_eq!(
            cause(&[boxed_in], &still, &[1], 0, &[]),
            Some(Cause::TimeoutIdle),
            "sent nowhere"
        );
    }

    /// An episode of agents that stay, and how it ended; an allocation is noted from a step on, if it is.
    fn episode(noted_from: Option<u32>, allocation: &[u8]) -> crate::Episode {
        use crate::Environment;
        use crate::random::generator;
        let set = super::super::ScenarioSet::named("2-5a_2-5b").unwrap();
        let mut city = super::super::SaveTheCity::new(set, Constants::default(), 1, 3).unwrap();
        let mut random = generator(3);
        Environment::reset(&mut city, 0, &mut random);
        while !city.is_done(0) {
            if noted_from.is_some_and(|from| city.metrics(0).steps >= from) {
                Environment::note_allocation(&mut city, 0, allocation);
            }
            city.step(0, &[0; 5], &mut random).unwrap();
        }
        city.episode(0)
    }

    #[test]
    fn whose_allocations_are_noted_is_told_why_it_failed_and_plays_as_before() {
        let all = [0; 5];
        let (silent, noted) = (episode(None, &all), episode(Some(0), &all));
        let late = episode(Some(7), &all);
        assert!(!noted.solved && noted.steps > 7, "{noted:?}");
        assert_eq!(silent.cause, None);
        assert!(noted.cause.is_some_and(|cause| Cause::NAMES.contains(&cause)), "{noted:?}");
        assert!(late.cause.is_some());
        assert_eq!(crate::Episode { cause: None, ..noted }, silent);
    }

    #[test]
    fn who_knows_no_subtasks_works_for_none() {
        let nothing = episode(Some(0), &[UNASSIGNED; 5]);
        assert_eq!(episode(Some(0), &[]), nothing);
        assert_eq!(nothing.cause, Some(Cause::BurnedUnattended.name()));
    }
}
