//! The operators of a plan, run one after the other: for an agent, for a policy, for a team.
//!
//! A run is compiled for every build of the kernels and every way to add products up: hundreds of kilobytes. Crates that are
//! optimised share no instances of generic functions, so that each that decides would compile runs of its own. Where a set
//! has all operators, as on every host, runs are therefore plain functions, compiled in this crate and nowhere else.

use super::Plan;
use super::header::{Network, Profile};
use super::program::Ops;
use crate::kernels::Kernels;
use crate::kernels::arithmetic::Exact;
#[cfg(any(test, feature = "std"))]
use crate::kernels::arithmetic::Fused;
use crate::kernels::build::{Build, Work};
use crate::ops::team::Team;
use crate::ops::{AllOperators, OperatorSet, Scratch, has_all};
use crate::policy::{DecideError, Observation};

/// On which build of the kernels a plan runs, and how it adds products up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlanArithmetic {
    build: Build,
    sums: Sums,
}

/// How products are added up. Only a build that has fused sums can say so.
#[derive(Clone, Copy, Debug)]
enum Sums {
    Exact,
    #[cfg(any(test, feature = "std"))]
    Fused,
}

impl PlanArithmetic {
    /// What a profile asks for; `None` where this build does not have it.
    pub(super) fn of(profile: Profile, build: Build) -> Option<Self> {
        let sums = match profile {
            Profile::Exact | Profile::Int8 => Sums::Exact,
            Profile::Fused if !build.fuses() => return None,
            #[cfg(any(test, feature = "std"))]
            Profile::Fused => Sums::Fused,
            #[cfg(not(any(test, feature = "std")))]
            Profile::Fused => return None,
        };
        Some(Self { build, sums })
    }

    /// The same on another build.
    pub(super) fn on(self, build: Build) -> Self {
        Self { build, ..self }
    }

    #[cfg(test)]
    pub(super) fn build(self) -> Build {
        self.build
    }

    /// Runs work, which is compiled into the caller for each build: callers are few.
    #[inline]
    pub(crate) fn run<W: Work>(self, work: W) -> W::Output {
        match self.sums {
            Sums::Exact => self.build.run::<Exact, W>(work),
            #[cfg(any(test, feature = "std"))]
            Sums::Fused => self.build.run::<Fused, W>(work),
        }
    }
}

impl<S: OperatorSet> Plan<'_, S> {
    /// Runs an agent's network, or one over all entities.
    #[inline]
    pub(super) fn run_agent(
        &self,
        observation: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let mut ops = self.program.ops();
        // Where no entity exists there is no row either, not even an agent's own.
        if self.header.network == Network::Entities && observation.visible.is_empty() {
            ops.next();
        }
        let run = Run::<S, false> { ops, weights: self.weights, observation, scratch };
        if const { has_all::<S>() } {
            agent_of_all(self.arithmetic, run.of_set())
        } else {
            self.arithmetic.run(run)
        }
    }

    /// Runs a policy, whose operators are steps.
    #[inline]
    pub(super) fn run_steps(
        &self,
        observation: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let ops = self.program.ops();
        let run = Run::<S, true> { ops, weights: self.weights, observation, scratch };
        if const { has_all::<S>() } {
            steps_of_all(self.arithmetic, run.of_set())
        } else {
            self.arithmetic.run(run)
        }
    }

    /// Runs an agent's network for all members of a team.
    #[inline]
    pub(super) fn run_members(
        &self,
        observations: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let ops = self.program.ops();
        let run = TeamRun::<S> { ops, weights: self.weights, observations, team };
        if const { has_all::<S>() } {
            members_of_all(self.arithmetic, run.of_set())
        } else {
            self.arithmetic.run(run)
        }
    }
}

// Images without `std` are linked whole, and leave it to the linker what becomes part of what.
#[cfg_attr(feature = "std", inline(never))]
fn agent_of_all(
    arithmetic: PlanArithmetic,
    run: Run<'_, '_, AllOperators, false>,
) -> Result<(), DecideError> {
    arithmetic.run(run)
}

#[cfg_attr(feature = "std", inline(never))]
fn steps_of_all(
    arithmetic: PlanArithmetic,
    run: Run<'_, '_, AllOperators, true>,
) -> Result<(), DecideError> {
    arithmetic.run(run)
}

#[cfg_attr(feature = "std", inline(never))]
fn members_of_all(
    arithmetic: PlanArithmetic,
    run: TeamRun<'_, '_, AllOperators>,
) -> Result<(), DecideError> {
    arithmetic.run(run)
}

/// All operators for one observation; those that are steps of policies only where `STEPS` says so.
struct Run<'p, 's, S, const STEPS: bool> {
    ops: Ops<'p, S>,
    weights: &'p [f32],
    observation: &'p Observation<'p>,
    scratch: &'p mut Scratch<'s>,
}

impl<'p, 's, S, const STEPS: bool> Run<'p, 's, S, STEPS> {
    fn of_set<T>(self) -> Run<'p, 's, T, STEPS> {
        let Self { ops, weights, observation, scratch } = self;
        Run { ops: ops.of(), weights, observation, scratch }
    }
}

impl<S: OperatorSet, const STEPS: bool> Work for Run<'_, '_, S, STEPS> {
    type Output = Result<(), DecideError>;

    #[inline(always)]
    fn run(self, kernels: impl Kernels) -> Self::Output {
        for op in self.ops {
            op.run::<S, STEPS>(kernels, self.weights, self.observation, self.scratch)?;
        }
        Ok(())
    }
}

/// All operators for all members of a team.
struct TeamRun<'p, 's, S> {
    ops: Ops<'p, S>,
    weights: &'p [f32],
    observations: &'p [Observation<'p>],
    team: &'p mut Team<'s>,
}

impl<'p, 's, S> TeamRun<'p, 's, S> {
    fn of_set<T>(self) -> TeamRun<'p, 's, T> {
        let Self { ops, weights, observations, team } = self;
        TeamRun { ops: ops.of(), weights, observations, team }
    }
}

impl<S: OperatorSet> Work for TeamRun<'_, '_, S> {
    type Output = Result<(), DecideError>;

    #[inline(always)]
    fn run(self, kernels: impl Kernels) -> Self::Output {
        for op in self.ops {
            op.run_team::<S>(kernels, self.weights, self.observations, self.team)?;
        }
        Ok(())
    }
}
