//! The program of a plan: what is computed, one operator after the other, read where it stands.
//!
//! A program is the floats of the arena, the marks behind them, then a record for every operator: its number and the
//! words of its fields, 16 bits each, then the fields as `repr(C)` lays them out. All of it is little-endian words.

use core::marker::PhantomData;

use super::error::PlanError;
use super::header::{Header, Network};
use crate::ops::proposal_arena::arena_floats;
use crate::ops::{
    AllOperators, Gru, Input, Meaning, OpRef, OperatorSet, Output, OutputRows, Place,
    ProposalNetwork, Sizes, State,
};

/// Most operators of one program, so that a check of each against all before it ends soon.
pub const OPS: usize = 4096;

/// How often a check may go through the operators before one, for each operator: once for every place that it reads, and
/// as often again as parts of it were written out of order.
const PASSES: usize = 16;

/// Bytes of a word, of which everything in a program is made.
const WORD: usize = 4;

/// The operators in order, and what the arena holds.
#[derive(Clone, Copy, Debug)]
pub struct Program<'a, S: OperatorSet = AllOperators> {
    floats: u32,
    nonzeros: u32,
    records: &'a [u8],
    found: Found<'a>,
    operators: PhantomData<S>,
}

/// What every decision asks a program for, found once.
#[derive(Clone, Copy, Debug, Default)]
struct Found<'a> {
    own_floats: Option<u32>,
    utilities: Option<Place>,
    memory: Option<&'a Gru>,
    inputs: usize,
    outputs: usize,
    /// The records from the first output on.
    ends: &'a [u8],
}

/// The operators of a program, one after the other; ends where no further one can be read.
#[derive(Clone, Debug)]
pub struct Ops<'a, S> {
    rest: &'a [u8],
    operators: PhantomData<S>,
}

impl<'a, S> Ops<'a, S> {
    /// The same operators as those of another set, which ends where it has not the next.
    pub(super) fn of<T>(self) -> Ops<'a, T> {
        Ops { rest: self.rest, operators: PhantomData }
    }
}

impl<'a, S: OperatorSet> Iterator for Ops<'a, S> {
    type Item = OpRef<'a>;

    #[inline(always)]
    fn next(&mut self) -> Option<OpRef<'a>> {
        let (&[low, high, words, more_words], rest) = self.rest.split_first_chunk::<WORD>()?;
        let bytes = WORD * usize::from(u16::from_le_bytes([words, more_words]));
        let (fields, rest) = rest.split_at_checked(bytes)?;
        let op = OpRef::read::<S>(u16::from_le_bytes([low, high]), fields)?;
        self.rest = rest;
        Some(op)
    }
}

impl<'a, S: OperatorSet> Program<'a, S> {
    /// Finds the operators of a program, which starts at a multiple of four bytes; whether they fit each other is
    /// not checked.
    ///
    /// # Errors
    /// `Misaligned`, `UnknownOp` where something is no operator of `S`, `ShapeMismatch` where there are more than
    /// [`OPS`].
    pub fn read(bytes: &'a [u8]) -> Result<Self, PlanError> {
        let address = bytes.as_ptr().addr();
        if !address.is_multiple_of(WORD) {
            let got = address & address.wrapping_neg();
            return Err(PlanError::Misaligned { need: WORD, got });
        }
        let (floats, rest) = bytes.split_first_chunk().ok_or(PlanError::UnknownOp)?;
        let (nonzeros, records) = rest.split_first_chunk().ok_or(PlanError::UnknownOp)?;
        let (floats, nonzeros) = (u32::from_le_bytes(*floats), u32::from_le_bytes(*nonzeros));
        let found = Found::default();
        let mut program = Self { floats, nonzeros, records, found, operators: PhantomData };
        let mut ops = program.ops();
        let count = ops.by_ref().take(OPS + 1).count();
        if count > OPS {
            return Err(PlanError::ShapeMismatch { op: OPS });
        }
        if !ops.rest.is_empty() {
            return Err(PlanError::UnknownOp);
        }
        program.found = program.find();
        Ok(program)
    }

    /// The operators; the first embeds entities, the last chooses the action or is an output.
    #[inline(always)]
    pub fn ops(&self) -> Ops<'a, S> {
        Ops { rest: self.records, operators: PhantomData }
    }

    /// Floats of the arena.
    pub fn floats(&self) -> u32 {
        self.floats
    }

    /// Marks behind the floats, which say which of 64 inputs are not zero.
    pub fn nonzeros(&self) -> u32 {
        self.nonzeros
    }

    /// Bytes of arena: floats, then marks of two words.
    pub fn arena_bytes(&self) -> u64 {
        4 * u64::from(self.floats) + 8 * u64::from(self.nonzeros)
    }

    fn find(&self) -> Found<'a> {
        let rows = self.ops().next().and_then(embedded);
        let own_floats = rows.and_then(|(rows, _)| {
            let own = self.floats.checked_sub(rows.len).filter(|own| *own > 0)?;
            self.ops().all(|op| op.works_for_teams(rows.len)).then_some(own)
        });
        let utilities = match self.ops().last() {
            Some(OpRef::MaskedArgmax(op)) => Some(op.from),
            Some(OpRef::MaskedSample(op)) => Some(op.from),
            _ => None,
        };
        let memory = self.ops().find_map(|op| match op {
            OpRef::Gru(gru) => Some(gru),
            _ => None,
        });
        let inputs = self.inputs().count();
        let mut ops = self.ops();
        let mut ends = ops.rest;
        while !matches!(ops.next(), None | Some(OpRef::Output(_))) {
            ends = ops.rest;
        }
        let is_output = |op: &OpRef<'_>| matches!(op, OpRef::Output(_));
        let outputs = self.ops().filter(is_output).count();
        Found { own_floats, utilities, memory, inputs, outputs, ends }
    }

    /// Floats of an agent's own places, behind the rows that a team shares; none where one agent is worked on
    /// after the other.
    pub fn own_floats(&self) -> Option<u32> {
        self.found.own_floats
    }

    /// Where the utilities stand after the program ran.
    pub fn utilities(&self) -> Option<Place> {
        self.found.utilities
    }

    /// Whether the utilities are logits to draw an action from.
    pub fn draws(&self) -> bool {
        matches!(self.ops().last(), Some(OpRef::MaskedSample(_)))
    }

    /// What the program remembers from one run to the next.
    pub fn memory(&self) -> Option<&'a Gru> {
        self.found.memory
    }

    /// Whether the layer behind the attention takes the own row as well.
    pub fn skips(&self) -> bool {
        self.ops().any(skips)
    }

    /// What the caller of a network with outputs reads, in order.
    #[inline(always)]
    pub fn outputs(&self) -> impl Iterator<Item = &'a Output> {
        let ends = Ops::<S> { rest: self.found.ends, operators: PhantomData };
        ends.filter_map(|op| match op {
            OpRef::Output(output) => Some(output),
            _ => None,
        })
    }

    /// How many outputs there are.
    pub fn output_count(&self) -> usize {
        self.found.outputs
    }

    /// The network of an allocator that proposes.
    pub fn proposal_network(&self) -> Option<ProposalNetwork> {
        let mut ops = self.ops();
        match [ops.next()?, ops.next()?, ops.next()?] {
            [
                OpRef::EmbedTasks(trunk),
                OpRef::PointerLogits(step),
                OpRef::ScoreAllocations(critic),
            ] if ops.next().is_none() => {
                Some(ProposalNetwork { trunk: *trunk, step: *step, critic: *critic })
            }
            _ => None,
        }
    }

    /// Checks the operators of an allocator that proposes, and that the arena is at least as large as they need it.
    fn check_proposals(&self, sizes: &Sizes, header: &Header) -> Result<(), PlanError> {
        for (index, op) in self.ops().enumerate() {
            if !(op.check::<S>(sizes) && op.kind().fits(header.layout)) {
                return Err(PlanError::ShapeMismatch { op: index });
            }
        }
        let network = self.proposal_network().filter(|network| {
            network.fits()
                && usize::from(header.t_max) == network.trunk.task_count()
                && u64::from(self.floats) >= arena_floats(network, sizes.n_max as usize)
                && (self.nonzeros, sizes.hidden) == (0, 0)
        });
        network.map(drop).ok_or_else(|| self.mismatch())
    }

    /// Checks every operator, that rows are embedded before anything reads them, and that the program ends as
    /// its network does: with one choice, or with outputs.
    pub(super) fn check(&self, sizes: &Sizes, header: &Header) -> Result<(), PlanError> {
        match header.network {
            Network::Proposals => return self.check_proposals(sizes, header),
            Network::Policy => return self.check_policy(sizes, header),
            _ => {}
        }
        let is_end = |op: OpRef<'_>| match header.network {
            Network::Entities => matches!(op, OpRef::Output(_)),
            Network::Proposals | Network::Policy => false,
            Network::Agent | Network::TeamValue => {
                matches!(op, OpRef::MaskedArgmax(_) | OpRef::MaskedSample(_))
            }
        };
        let mut units = 0;
        let mut ends = 0;
        for (index, op) in self.ops().enumerate() {
            let first = embedded(op).is_some() == (index == 0);
            let is_choice = matches!(op, OpRef::MaskedArgmax(_) | OpRef::MaskedSample(_));
            let in_place = match op {
                OpRef::MaskedArgmax(_) | OpRef::MaskedSample(_) | OpRef::Output(_) => is_end(op),
                _ if op.kind().is_of_proposals() || op.kind().is_step() => false,
                _ => ends == 0,
            };
            units += u32::from(matches!(op, OpRef::Gru(_)));
            ends += u32::from(is_end(op));
            let alone = !is_choice || ends == 1;
            let fits = first && in_place && alone && units <= 1 && op.kind().fits(header.layout);
            if !(fits && self.reads_written_rows(index, op) && op.check::<S>(sizes)) {
                return Err(PlanError::ShapeMismatch { op: index });
            }
        }
        let remembered = self.memory().map_or(0, |gru| gru.size);
        // A network over all entities has no own row.
        let fits_skip =
            self.skips() == header.skip && !(header.skip && header.network == Network::Entities);
        if ends == 0 || remembered != sizes.hidden || !fits_skip {
            return Err(self.mismatch());
        }
        Ok(())
    }

    /// The inputs of a policy, in the caller's order.
    pub fn inputs(&self) -> impl Iterator<Item = &'a Input> {
        self.firsts().filter_map(|op| match op {
            OpRef::Input(input) => Some(input),
            _ => None,
        })
    }

    /// Whether an agent of a team can decide by it: it chooses an action, and observes all inputs.
    pub fn acts_in_teams(&self) -> bool {
        let observes = |input: &Input| input.meaning != Meaning::None;
        self.utilities().is_some() && self.inputs().all(observes)
    }

    /// How many inputs there are.
    pub fn input_count(&self) -> usize {
        self.found.inputs
    }

    /// The recurrent states of a policy, in the order in which the caller keeps them.
    #[inline(always)]
    pub fn states(&self) -> impl Iterator<Item = &'a State> {
        self.firsts().filter_map(|op| match op {
            OpRef::State(state) => Some(state),
            _ => None,
        })
    }

    /// Inputs and states, which stand before all steps.
    #[inline(always)]
    fn firsts(&self) -> impl Iterator<Item = OpRef<'a>> {
        self.ops().take_while(|op| matches!(op, OpRef::Input(_) | OpRef::State(_)))
    }

    /// Checks a policy: inputs and states first, then steps, each of which reads what was written before it, then one
    /// choice or the outputs.
    fn check_policy(&self, sizes: &Sizes, header: &Header) -> Result<(), PlanError> {
        let (mut inputs, mut part) = (0, PolicyPart::Inputs);
        let count = self.ops().count();
        let mut passes = PASSES * count;
        for (index, op) in self.ops().enumerate() {
            let own = PolicyPart::of(op);
            let numbered = match op {
                OpRef::Input(input) => u32::from(input.index) == inputs,
                _ => true,
            };
            inputs += u32::from(matches!(op, OpRef::Input(_)));
            // Nothing follows a choice.
            let in_order = own.is_some_and(|own| own >= part) && part != PolicyPart::Choice;
            let written =
                op.reads().iter().all(|place| self.is_written(*place, index, &mut passes));
            let fits = numbered && in_order && written && op.kind().fits(header.layout);
            if !(fits && op.check::<S>(sizes)) {
                return Err(PlanError::ShapeMismatch { op: index });
            }
            part = own.unwrap_or(part);
        }
        let known = self.states().all(|state| self.is_written(state.to, count, &mut passes));
        let hidden = self.states().fold(0, |sum: u32, state| sum.saturating_add(state.from.len));
        let ends = matches!(part, PolicyPart::Outputs | PolicyPart::Choice);
        let fits = inputs > 0 && ends && known && hidden == sizes.hidden && !header.skip;
        fits.then_some(()).ok_or_else(|| self.mismatch())
    }

    /// Whether the operators before `index` wrote all floats of a place, if so many passes through them tell.
    fn is_written(&self, place: Place, index: usize, passes: &mut usize) -> bool {
        let end = u64::from(place.offset) + u64::from(place.len);
        let mut at = u64::from(place.offset);
        while at < end {
            let Some(left) = passes.checked_sub(1) else { return false };
            *passes = left;
            let mut next = at;
            for written in self.ops().take(index).map(OpRef::writes) {
                for place in written.iter() {
                    let start = u64::from(place.offset);
                    if start <= next {
                        next = next.max(start + u64::from(place.len));
                    }
                }
            }
            if next == at {
                return false;
            }
            at = next;
        }
        true
    }

    /// Something about the program as a whole does not fit.
    pub(super) fn mismatch(&self) -> PlanError {
        PlanError::ShapeMismatch { op: self.ops().count() }
    }

    /// Whether the rows that an operator reads are rows that an earlier one wrote.
    fn reads_written_rows(&self, index: usize, op: OpRef<'_>) -> bool {
        let (place, width) = match op {
            OpRef::AttendOwn(op) => (op.rows, op.width.into()),
            OpRef::Int8AttendOwn(op) => (op.rows, op.width.into()),
            OpRef::AttendAll(op) => (op.rows, op.width.into()),
            OpRef::MeanRows(op) => (op.rows, op.width.into()),
            OpRef::GroupSum(op) => (op.rows, op.width.into()),
            OpRef::PointAtEntities(op) => (op.rows, op.targets.width.into()),
            OpRef::Int8PointAtEntities(op) => (op.rows, op.targets.width.into()),
            OpRef::Output(Output { from, width, rows: OutputRows::Entities, .. }) => {
                (*from, *width)
            }
            _ => return true,
        };
        let own = matches!(
            op,
            OpRef::AttendOwn(_)
                | OpRef::Int8AttendOwn(_)
                | OpRef::PointAtEntities(_)
                | OpRef::Int8PointAtEntities(_)
        );
        self.ops().take(index).any(|before| match before {
            OpRef::EmbedEntities(_) | OpRef::Int8EmbedEntities(_) => {
                embedded(before) == Some((place, width))
            }
            // It writes no row for an agent that does not see itself.
            OpRef::AttendAll(before) => {
                !own && (before.to, before.output.outputs.into()) == (place, width)
            }
            _ => false,
        })
    }
}

/// The parts of a policy's program, in order.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum PolicyPart {
    Inputs,
    Steps,
    Outputs,
    Choice,
}

impl PolicyPart {
    /// Where an operator stands; `None` if in no policy.
    fn of(op: OpRef<'_>) -> Option<Self> {
        match op {
            OpRef::Input(_) | OpRef::State(_) => Some(Self::Inputs),
            OpRef::Dense(_) | OpRef::Int8Dense(_) | OpRef::Gru(_) => Some(Self::Steps),
            OpRef::Output(Output { rows: OutputRows::One, .. }) => Some(Self::Outputs),
            OpRef::MaskedArgmax(_) | OpRef::MaskedSample(_) => Some(Self::Choice),
            op => op.kind().is_step().then_some(Self::Steps),
        }
    }
}

fn skips(op: OpRef<'_>) -> bool {
    match op {
        OpRef::AttendOwn(op) => op.skips(),
        OpRef::Int8AttendOwn(op) => op.skips(),
        _ => false,
    }
}

/// The rows that an operator embeds, and their width.
fn embedded(op: OpRef<'_>) -> Option<(Place, u32)> {
    match op {
        OpRef::EmbedEntities(op) => Some((op.rows, op.layer.outputs.into())),
        OpRef::Int8EmbedEntities(op) => Some((op.rows, op.layer.outputs.into())),
        _ => None,
    }
}
