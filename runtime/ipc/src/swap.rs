//! Changing the bundle of a running team: every process opens it beside the one in use, and all change at one tick or none.

use sortie_core::wire::{Command, ControlStatus, Role, SwapMoment, SwapOrder, TurnBack};

use crate::control::{Answer, Order, control};
use crate::domain::{Domain, Lock, Membership, model_text};
use crate::error::Error;
use crate::process_info::{Candidate, ProcessInfo};

/// A change of bundle under way. Until it is dropped no other process can begin one; what dies lets it go.
#[derive(Debug)]
pub struct Swap {
    name: String,
    model: [u8; 16],
    generation: u16,
    _lock: Lock,
    /// Dropped last.
    membership: Membership,
}

/// How far the processes of a team are with a bundle that they were told to open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Readiness {
    /// Every process that decides has it, and for every agent for which a process acts there is one.
    Ready,
    /// Not yet.
    Opening,
    /// Some have refused it, and why: the team keeps what it has.
    Refused(Vec<(ProcessInfo, ControlStatus)>),
}

impl Swap {
    /// Tells the world and all who decide to open the bundle of folder `name`, beside their own, whose id begins with
    /// `model`.
    ///
    /// # Errors
    /// [`Error::Busy`]: another process changes the bundle. [`Error::NoWorld`]: no world runs, or it does not answer.
    pub fn begin(
        domain: &Domain,
        name: &str,
        model: [u8; 16],
    ) -> Result<Result<Self, Vec<Answer>>, Error> {
        let nobody = || Error::NoWorld { domain: domain.id().to_string() };
        if !domain.is_alive()? {
            return Err(nobody());
        }
        let membership = domain.enter()?;
        let lock = membership.lead_swap()?;
        let generation = membership.facts()?.ok_or_else(nobody)?.bundles().generation();
        let prepare = Order { number: generation.into(), ..Order::new(Command::PrepareBundle) };
        // The world first: who joins from now on finds in the domain what to open.
        let world = world_of(&control(domain, &Order::new(Command::Info))?).ok_or_else(nobody)?;
        let order = prepare.with_text(name);
        let told = control(domain, &Order { process: Some(world.pid), ..order })?;
        if !is_done(&told) {
            return Ok(Err(told));
        }
        // It is told once more with all others, and goes on opening what it opens.
        let (name, told) = (name.to_string(), control(domain, &order)?);
        let others: Vec<Answer> =
            told.into_iter().filter(|answer| answer.process.role != Role::World).collect();
        let swap = Self { name, model, generation, _lock: lock, membership };
        Ok(if is_done(&others) { Ok(swap) } else { Err(others) })
    }

    /// The name of the bundle's folder.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The generation that the change makes.
    pub fn next_generation(&self) -> u16 {
        self.generation.wrapping_add(1)
    }

    /// What the processes of the team say of themselves.
    ///
    /// # Errors
    /// Nobody runs any more, or the domain cannot be used.
    pub fn processes(&self) -> Result<Vec<ProcessInfo>, Error> {
        let answers = control(self.membership.domain(), &Order::new(Command::Info))?;
        Ok(answers.into_iter().map(|answer| answer.process).collect())
    }

    /// How far the processes are.
    ///
    /// # Errors
    /// As [`Self::processes`].
    pub fn readiness(&self) -> Result<Readiness, Error> {
        let processes = self.processes()?;
        Ok(readiness(&processes, self.model))
    }

    /// Changes to the bundle. `back` holds for so many ticks.
    ///
    /// # Errors
    /// The domain cannot be used. `Err` in `Ok`: the world does not, and why; nothing has changed.
    pub fn change(
        &self,
        moment: SwapMoment,
        back: TurnBack,
        watched_ticks: u32,
    ) -> Result<Result<(), Vec<Answer>>, Error> {
        let order = SwapOrder { generation: self.generation, moment, back, watched_ticks };
        self.order_change(order, &model_text(self.model))
    }

    /// Turns back to the bundle before the change, at the next tick.
    ///
    /// # Errors
    /// As [`Self::change`].
    pub fn turn_back(&self) -> Result<Result<(), Vec<Answer>>, Error> {
        let generation = self.next_generation();
        let facts = self.membership.facts()?;
        let before = facts.map(|facts| facts.bundles().other().model.clone()).unwrap_or_default();
        self.order_change(SwapOrder { generation, ..SwapOrder::default() }, &before)
    }

    fn order_change(
        &self,
        order: SwapOrder,
        model: &str,
    ) -> Result<Result<(), Vec<Answer>>, Error> {
        let number = order.to_number();
        let order = Order { number, ..Order::new(Command::SwapBundle) }.with_text(model);
        let told = control(self.membership.domain(), &order)?;
        Ok(if is_done(&told) { Ok(()) } else { Err(told) })
    }
}

fn world_of(answers: &[Answer]) -> Option<ProcessInfo> {
    let mut worlds = answers.iter().map(|answer| answer.process);
    worlds.find(|process| process.role == Role::World)
}

/// Whether somebody was told, and all did as they were told.
fn is_done(answers: &[Answer]) -> bool {
    !answers.is_empty() && answers.iter().all(|answer| answer.status == Some(ControlStatus::Done))
}

fn readiness(processes: &[ProcessInfo], model: [u8; 16]) -> Readiness {
    let decides = |process: &&ProcessInfo| {
        let is_role = matches!(process.role, Role::Runner | Role::Allocator) && !process.serves;
        // A world has one where it acts for agents itself.
        is_role || process.candidate != Candidate::None
    };
    let refused = processes.iter().filter_map(|process| match process.candidate {
        Candidate::Refused { status } => Some((*process, status)),
        _ => None,
    });
    let refused: Vec<_> = refused.collect();
    if !refused.is_empty() {
        return Readiness::Refused(refused);
    }
    let of_role =
        |role| processes.iter().filter(move |process| process.role == role && !process.serves);
    let seats = of_role(Role::World).fold(0, |seats, world| seats | world.agents);
    let acted_for = of_role(Role::Runner).fold(0, |seats, runner| seats | runner.agents);
    let are_ready = processes
        .iter()
        .filter(decides)
        .all(|process| process.candidate == Candidate::ready(model));
    if are_ready && seats & !acted_for == 0 { Readiness::Ready } else { Readiness::Opening }
}

#[cfg(test)]
mod tests {
    use sortie_core::roles::Identity;

    use super::*;

    const MODEL: [u8; 16] = [7; 16];

    fn process(role: Role, agents: u64, candidate: Candidate) -> ProcessInfo {
        ProcessInfo { agents, candidate, ..ProcessInfo::new(role, &Identity::new(1, "one")) }
    }

    #[test]
    fn a_team_is_ready_when_all_who_decide_have_the_bundle_and_no_seat_is_left_out() {
        let ready = Candidate::ready(MODEL);
        let team = |first: Candidate, second: u64| {
            let processes = [
                process(Role::World, 0b11, Candidate::None),
                process(Role::Runner, 1, first),
                process(Role::Runner, second, ready),
                process(Role::Allocator, 0, ready),
            ];
            readiness(&processes, MODEL)
        };
        assert_eq!(team(ready, 2), Readiness::Ready);
        assert_eq!(team(Candidate::None, 2), Readiness::Opening);
        assert_eq!(team(Candidate::Loading, 2), Readiness::Opening);
        assert_eq!(team(Candidate::ready([8; 16]), 2), Readiness::Opening);
        // A seat whose process has not answered.
        assert_eq!(team(ready, 0), Readiness::Opening);
        let status = ControlStatus::Foreign;
        let refused = team(Candidate::Refused { status }, 2);
        assert!(matches!(&refused, Readiness::Refused(by) if by[0].1 == status), "{refused:?}");
    }

    #[test]
    fn a_world_that_acts_for_agents_itself_has_to_be_ready_too() {
        let ready = Candidate::ready(MODEL);
        for (candidate, expected) in
            [(Candidate::Loading, Readiness::Opening), (ready, Readiness::Ready)]
        {
            assert_eq!(readiness(&[process(Role::World, 0, candidate)], MODEL), expected);
        }
    }
}
