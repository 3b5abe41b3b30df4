//! The team's end of a line.

use embedded_io::{Read, ReadReady, Write};
use heapless::Deque;
use zerocopy::FromZeros;

use super::line::{Broken, Line, LineCounters};
use super::packet::{AllocationPacket, Packer, Packet, SMALL_PACKET, Unpacker};
use super::view;
use crate::link::{AgentLink, Clock, LinkError};
use crate::wire::{ActionMsg, AllocMsg, FrameFormat, Role, StatMsg};

/// Allocations sent in one turn: one of each allocator that may be in the team.
const ALLOCATIONS: usize = 4;

/// Stands in a team for the runner at the other end of a serial line, a [`Serial`](super::Serial):
/// sends it what its agents see, and passes on what it answers.
pub struct Relay<'b, IO> {
    line: Line<IO, [u8; SMALL_PACKET]>,
    format: FrameFormat,
    agents: u64,
    outgoing: &'b mut [u8],
    /// The newest allocation, for a runner that begins anew.
    newest: Option<AllocMsg>,
    /// The team knows of the runner.
    is_announced: bool,
    is_heard: bool,
}

impl<'b, IO: Read + ReadReady + Write> Relay<'b, IO> {
    /// The runner acts for `agents`, bit a for agent a: it is shown what they see, and acts for nobody
    /// else. `packet` holds as many bytes as a frame's packet may have:
    /// [`packet_bytes`](super::packet_bytes) at most.
    pub fn new(io: IO, format: FrameFormat, agents: u64, packet: &'b mut [u8]) -> Self {
        let line = Line::new(io, [0; SMALL_PACKET]);
        Self {
            line,
            format,
            agents,
            outgoing: packet,
            newest: None,
            is_announced: false,
            is_heard: false,
        }
    }

    /// What came over the line.
    pub fn counters(&self) -> &LineCounters {
        &self.line.counters
    }

    /// Whether anything was heard since the last call.
    pub fn take_heard(&mut self) -> bool {
        core::mem::take(&mut self.is_heard)
    }

    /// Sends what is new in the team, then passes on what came over the line. To be called when the
    /// bell of `team` rings, and so often as actions may be late.
    ///
    /// # Errors
    /// A topic failed; [`LinkError::Bell`]: the line did.
    pub fn turn(&mut self, team: &mut impl AgentLink) -> Result<(), LinkError> {
        self.send_frame(team)?;
        self.send_allocations(team)?;
        self.pass_on(team)
    }

    /// Sends the newest frame; of one that is unsound, or for which there is no room, nothing.
    fn send_frame(&mut self, team: &mut impl AgentLink) -> Result<(), LinkError> {
        let Self { format, agents, outgoing, line, .. } = self;
        let now_ns = team.now_ns();
        let mut len = None;
        team.receive_frames(&mut |frame| {
            let mut packer = Packer::new(outgoing);
            let written = view::write(frame, format, *agents, now_ns, &mut packer);
            len = written.and_then(|()| packer.seal()).map(<[u8]>::len);
            false
        })?;
        match len.and_then(|len| outgoing.get(..len)) {
            Some(packet) => line.send(packet).map_err(|Broken| LinkError::Bell),
            None => Ok(()),
        }
    }

    fn send_allocations(&mut self, team: &mut impl AgentLink) -> Result<(), LinkError> {
        let mut waiting: Deque<AllocMsg, ALLOCATIONS> = Deque::new();
        team.receive_allocations(&mut |allocation| {
            if waiting.is_full() {
                waiting.pop_front();
            }
            // There is room: one was taken out above.
            let _ = waiting.push_back(*allocation);
        })?;
        // Allocations are ordered by term and epoch, however they come.
        self.newest = waiting.iter().copied().chain(self.newest).max_by_key(AllocMsg::order);
        waiting.iter().try_for_each(|allocation| self.send_allocation(allocation))
    }

    fn send_allocation(&mut self, allocation: &AllocMsg) -> Result<(), LinkError> {
        let mut bytes = [0; SMALL_PACKET];
        let mut packer = Packer::new(&mut bytes);
        let packet = Packet::Allocation(AllocationPacket::new(allocation));
        let packet = packer.put(&packet).and_then(|()| packer.seal());
        let sent = packet.map(|packet| self.line.send(packet));
        sent.and_then(Result::ok).ok_or(LinkError::Bell)
    }

    fn pass_on(&mut self, team: &mut impl AgentLink) -> Result<(), LinkError> {
        let (now_ns, agents) = (team.now_ns(), self.agents);
        let (mut is_heard, mut is_behind) = (false, false);
        loop {
            let received = self.line.receive(&Now(now_ns)).map_err(|Broken| LinkError::Bell)?;
            let Some((bytes, _)) = received else { break };
            let mut packet = Unpacker(bytes);
            match packet.take().filter(|_| packet.is_empty()) {
                Some(Packet::Action(action)) if acts(agents, &action.message(now_ns)) => {
                    let message = action.message(now_ns);
                    if !core::mem::replace(&mut self.is_announced, true) {
                        team.send_status(&announcement(agents, &message))?;
                    }
                    is_behind |= self.newest.is_some_and(|newest| is_overdue(&newest, &message));
                    team.send_action(&message)?;
                }
                Some(Packet::Status(status)) => {
                    let message = status.message(now_ns).filter(|status| speaks(agents, status));
                    let Some(message) = message else {
                        self.line.counters.refused += 1;
                        continue;
                    };
                    self.is_announced = true;
                    is_behind |= message.has(StatMsg::HELLO);
                    team.send_status(&message)?;
                }
                _ => {
                    self.line.counters.refused += 1;
                    continue;
                }
            }
            is_heard = true;
        }
        self.is_heard |= is_heard;
        // Whoever joins late is shown the newest allocation, as on every link; and so is whom it did not reach.
        if let Some(newest) = self.newest.filter(|_| is_behind) {
            self.send_allocation(&newest)?;
        }
        if is_heard { team.ring(Role::World) } else { Ok(()) }
    }
}

/// Whether a runner acts on another allocation than the newest, which holds for that tick.
fn is_overdue(newest: &AllocMsg, action: &ActionMsg) -> bool {
    let order = (action.alloc_term, action.alloc_epoch);
    newest.order() != order && (newest.tick..=newest.valid_until).contains(&action.tick)
}

/// What the team is told of a runner whose own words were lost: that it acts.
fn announcement(agents: u64, action: &ActionMsg) -> StatMsg {
    StatMsg {
        schema: action.schema,
        abi: action.abi,
        pid: action.runner,
        role: Role::Runner as u8,
        // The limit of agents fits the field.
        n_agents: agents.count_ones() as u16,
        agents,
        t_ns: action.t_ns,
        start_ns: action.t_ns,
        last_tick: action.tick,
        ..StatMsg::new_zeroed()
    }
}

/// Whether the action is that of one of `agents`.
fn acts(agents: u64, action: &ActionMsg) -> bool {
    agents.checked_shr(u32::from(action.agent)).is_some_and(|agents| agents & 1 == 1)
}

/// Whether the status is that of a runner of these agents.
fn speaks(agents: u64, status: &StatMsg) -> bool {
    status.role == Role::Runner as u8 && status.agents & !agents == 0
}

/// A moment.
struct Now(u64);

impl Clock for Now {
    fn now_ns(&self) -> u64 {
        self.0
    }
}
