//! How far a team's allocations are from the best that its network knows.

use std::collections::VecDeque;
use std::path::Path;

use sortie_core::UNASSIGNED;
use sortie_core::plan::AlignedBytes;
use sortie_core::wire::{AllocMsg, FrameFormat, FrameHeader, FrameKind, FrameView};
use sortie_ipc::{DomainFacts, Heard};

use crate::deployment::open_bundle;
use crate::failure::{Exit, Failure};
use crate::views::probes::TeamNetwork;

/// An allocation is made of a frame that is hardly older than this many.
const KEPT: usize = 8;
/// Who watches leaves the processor to those who work: at most so many searches a second.
const SEARCH_EVERY_NS: u64 = 100_000_000;

/// What an allocation is worth by the network that values teams, and how much more the best would be that its search finds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Worth {
    pub(super) value: f64,
    pub(super) regret: f64,
}

/// Who values what a team is allocated to.
pub(super) struct Judge {
    network: TeamNetwork,
    format: FrameFormat,
    /// The newest whole frames.
    frames: VecDeque<(FrameHeader, AlignedBytes)>,
    searched_ns: u64,
    worth: Option<Worth>,
}

impl Judge {
    /// By the network of the team's bundle.
    ///
    /// # Errors
    /// The bundle is another team's, or its network values no teams.
    pub(super) fn open(folder: &Path, facts: &DomainFacts) -> Result<Self, Failure> {
        let bundle = open_bundle(folder)?;
        if bundle.contract().hash() != facts.contract_hash() {
            let message = format!("{} is not what this team plays by", folder.display());
            return Err(Failure::new(Exit::Mismatch, message));
        }
        if bundle.allocator_onnx().is_none() {
            let message = format!(
                "{} has no network that values teams, so that there is no regret to tell",
                folder.display()
            );
            return Err(Failure::new(Exit::Usage, message));
        }
        let (network, format) = (TeamNetwork::open(&bundle)?, facts.format()?);
        Ok(Self { network, format, frames: VecDeque::new(), searched_ns: 0, worth: None })
    }

    /// Takes in what the team says.
    pub(super) fn hear(&mut self, heard: Heard<'_>, now_ns: u64) {
        match heard {
            Heard::Frame(header, payload) if header.kind != FrameKind::WarmUp as u16 => {
                if self.frames.len() == KEPT {
                    self.frames.pop_front();
                }
                self.frames.push_back((*header, AlignedBytes::copy_of(payload)));
            }
            Heard::Allocation(it) if now_ns >= self.searched_ns + SEARCH_EVERY_NS => {
                if let Some(worth) = self.judged(it) {
                    (self.searched_ns, self.worth) = (now_ns, Some(worth));
                }
            }
            _ => {}
        }
    }

    /// Of the newest allocation that was judged.
    pub(super) fn worth(&self) -> Option<Worth> {
        self.worth
    }

    /// None where its frame was missed, or nobody is given anything in it.
    fn judged(&mut self, it: &AllocMsg) -> Option<Worth> {
        let (header, payload) =
            self.frames.iter().rev().find(|(header, _)| header.tick == it.tick)?;
        let view = FrameView::new(header, payload.as_slice(), &self.format).ok()?;
        let state = view.allocation_state();
        it.task.iter().take(state.agents).find(|task| **task != UNASSIGNED)?;
        let best = self.network.best(&state).ok()?;
        let value = self.network.worth(state, &it.task).ok()?;
        let most = self.network.worth(view.allocation_state(), &best).ok()?;
        Some(Worth { value, regret: most - value })
    }
}
