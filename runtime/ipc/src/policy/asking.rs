//! What a robot asks, and what it makes of the answers: whatever carries them, and by whatever clock.

use std::time::Duration;

use sortie_core::link::{Clock, Wake};
use sortie_core::plan::Trip;
use sortie_core::wire::{
    AnswerHead, AnswerStatus, MessageError, ObservationHead, Reason, ServedFormat,
};

use super::Fallback;
use crate::domain::nanoseconds;
use crate::error::Error;
use crate::processes::HEARTBEAT_NS;

/// A way to the server and back, and the clock that both ends go by.
pub(super) trait Line: Clock {
    /// Sends the message that `write` writes.
    fn send(&self, write: impl FnOnce(&mut [u8]) -> Result<(), MessageError>) -> Result<(), Error>;

    /// What `read` makes of the next message that waits; none where none does.
    fn receive<T>(&self, read: impl FnOnce(&[u8]) -> T) -> Option<T>;

    /// The bell's state, taken before looking for messages.
    fn token(&self) -> u32;

    /// Waits for the server's bell since `token` was taken, or until `until_ns`.
    fn wait(&self, token: u32, until_ns: u64) -> Wake;
}

/// What a client met since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClientCounters {
    /// Answers of the policy, late ones among them.
    pub answered: u64,
    /// Answers of the policy that were sent after the deadline and still waited for.
    pub late: u64,
    /// Fallbacks, the server's and its own.
    pub fallbacks: u64,
    /// Fallbacks of the server where a guard tripped, or was held.
    pub guarded: u64,
    /// Answers of the policy that were brought back to their limits.
    pub clamped: u64,
    /// Observations without any answer in time.
    pub silent: u64,
    /// Answers to earlier observations: they came too late.
    pub overdue: u64,
    /// Messages that are no answers of this policy.
    pub foreign: u64,
    /// Times that the server has lost the recurrent state within an episode.
    pub lost_states: u64,
}

/// What a robot is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Action<'a> {
    /// Whether it is the policy's, or the fallback.
    pub status: AnswerStatus,
    /// Why it is the fallback.
    pub reason: Reason,
    /// The guard that tripped: for it this is the fallback, or these are outputs that were brought back to their limits.
    pub guard: Option<Trip>,
    /// The action; `None` where the policy does not choose, or none is available.
    pub action: Option<u16>,
    /// All outputs, one behind the other.
    pub outputs: &'a [f32],
    /// The server began within the episode with a new recurrent state: it was started anew. Said once, also where its
    /// first answer came too late.
    pub lost_state: bool,
}

/// What is made of an answer.
struct Taken {
    status: AnswerStatus,
    reason: Reason,
    guard: Option<Trip>,
}

/// A robot's session with whoever answers.
pub(super) struct Asking {
    format: ServedFormat,
    deadline_ns: u64,
    fallback: Fallback,
    session: u64,
    seq: u64,
    episode: u32,
    /// The episode's first observation.
    first_seq: u64,
    /// Whether the policy has answered in this episode.
    is_remembered: bool,
    /// Whether it has then lost the episode's state, which is not told yet.
    lost_state: bool,
    /// What was done last.
    outputs: Vec<f32>,
    action: Option<u16>,
    counters: ClientCounters,
}

impl Asking {
    /// Nothing was asked yet. `session` is a number that no two clients have.
    pub(super) fn new(
        format: ServedFormat,
        deadline: Duration,
        fallback: Fallback,
        session: u64,
    ) -> Self {
        Self {
            format,
            deadline_ns: nanoseconds(deadline),
            fallback,
            session,
            seq: 0,
            episode: 0,
            first_seq: 1,
            is_remembered: false,
            lost_state: false,
            outputs: vec![0.0; format.outputs()],
            action: None,
            counters: ClientCounters::default(),
        }
    }

    pub(super) fn counters(&self) -> ClientCounters {
        self.counters
    }

    pub(super) fn set_deadline(&mut self, deadline: Duration) {
        self.deadline_ns = nanoseconds(deadline);
    }

    pub(super) fn begin_episode(&mut self) {
        self.episode = self.episode.wrapping_add(1);
        self.first_seq = self.seq + 1;
        self.is_remembered = false;
        self.lost_state = false;
    }

    /// What to do on these inputs, which are the policy's. `goes_on` is asked at every heartbeat without an answer.
    pub(super) fn decide(
        &mut self,
        line: &impl Line,
        inputs: &[&[f32]],
        available: &[u16],
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Result<Action<'_>, Error> {
        self.seq += 1;
        let t_ns = line.now_ns();
        let deadline_ns = t_ns.saturating_add(self.deadline_ns);
        let Self { session, seq, episode, format, .. } = *self;
        let head =
            ObservationHead { session, seq, t_ns, deadline_ns, episode, ..Default::default() };
        let sent = line.send(|to| format.write_observation(&head, inputs, available, to));
        let answer = match sent {
            Ok(()) => self.await_answer(line, deadline_ns, goes_on)?,
            Err(_) => None,
        };
        let Taken { status, reason, guard } = match answer {
            Some(answer) => self.take(&answer, available),
            None => {
                self.counters.silent += 1;
                self.fall_back(Reason::Silence, available)
            }
        };
        let lost_state = std::mem::take(&mut self.lost_state);
        let (action, outputs) = (self.action, self.outputs.as_slice());
        Ok(Action { status, reason, guard, action, outputs, lost_state })
    }

    /// Waits for the answer to the newest observation, and copies its outputs.
    fn await_answer(
        &mut self,
        line: &impl Line,
        deadline_ns: u64,
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Result<Option<AnswerHead>, Error> {
        loop {
            let token = line.token();
            if let Some(answer) = self.look(line) {
                return Ok(Some(answer));
            }
            let now_ns = line.now_ns();
            if now_ns >= deadline_ns {
                return Ok(None);
            }
            let heartbeat_ns = now_ns.saturating_add(HEARTBEAT_NS);
            let woken = line.wait(token, deadline_ns.min(heartbeat_ns));
            if woken == Wake::Timeout && heartbeat_ns < deadline_ns && !goes_on() {
                return Err(Error::Interrupted);
            }
        }
    }

    fn look(&mut self, line: &impl Line) -> Option<AnswerHead> {
        while let Some(answer) = line.receive(|bytes| self.read(bytes)) {
            if answer.is_some() {
                return answer;
            }
        }
        None
    }

    /// The answer that is waited for; what else comes is counted.
    fn read(&mut self, bytes: &[u8]) -> Option<AnswerHead> {
        let Ok(answer) = self.format.read_answer(bytes) else {
            self.counters.foreign += 1;
            return None;
        };
        let AnswerHead { session, seq, .. } = *answer.head;
        if session == self.session && seq >= self.first_seq {
            let lost_state = self.is_remembered && answer.head.has(AnswerHead::STATE_RESET);
            self.lost_state |= lost_state;
            self.counters.lost_states += u64::from(lost_state);
            self.is_remembered = true;
        }
        if (session, seq) != (self.session, self.seq) {
            self.counters.overdue += 1;
            return None;
        }
        if answer.head.status != AnswerStatus::Refused as u16 {
            self.outputs.copy_from_slice(answer.outputs);
        }
        Some(*answer.head)
    }

    /// Does what the server says; what it refuses, or says in numbers that mean nothing, is the fallback.
    fn take(&mut self, answer: &AnswerHead, available: &[u16]) -> Taken {
        let reason = Reason::from_number(answer.reason).unwrap_or(Reason::Policy);
        match AnswerStatus::from_number(answer.status) {
            Some(AnswerStatus::Refused) | None => self.fall_back(reason, available),
            Some(_) if !is_available(answer.action, available) => {
                self.fall_back(Reason::Policy, available)
            }
            Some(status) => {
                let is_fallback = status == AnswerStatus::Fallback;
                self.counters.fallbacks += u64::from(is_fallback);
                self.counters.answered += u64::from(!is_fallback);
                self.counters.late += u64::from(status == AnswerStatus::Late);
                self.counters.guarded += u64::from(is_fallback && reason == Reason::Guard);
                self.counters.clamped += u64::from(answer.has(AnswerHead::CLAMPED));
                self.action = u16::try_from(answer.action).ok();
                Taken { status, reason, guard: answer.trip() }
            }
        }
    }

    fn fall_back(&mut self, reason: Reason, available: &[u16]) -> Taken {
        self.counters.fallbacks += 1;
        self.action = self.fallback.apply(&mut self.outputs, self.action, available);
        Taken { status: AnswerStatus::Fallback, reason, guard: None }
    }
}

/// Whether an action may be taken; -1 where none may.
fn is_available(action: i32, available: &[u16]) -> bool {
    match usize::try_from(action) {
        Ok(action) => available.get(action).is_some_and(|&code| code != 0),
        Err(_) => action == -1 && available.iter().all(|&code| code == 0),
    }
}

#[cfg(test)]
mod tests {
    use std::cell::{Cell, RefCell};
    use std::collections::VecDeque;

    use sortie_core::plan::AlignedBytes;

    use super::*;

    const START_NS: u64 = 1_000;
    const SESSION: u64 = 7;
    const MS: u64 = 1_000_000;
    /// Flags of an answer that begins with a new state.
    const ANEW: u16 = AnswerHead::STATE_RESET;

    /// One input, two scores, two actions.
    fn format() -> ServedFormat {
        ServedFormat::new(9, 1, 2, 2).unwrap()
    }

    /// What every answer carries.
    const OUTPUTS: [f32; 2] = [0.25, 0.5];

    /// A line on which time passes by waiting alone, and answers come at their times.
    struct Script {
        now_ns: Cell<u64>,
        answers: RefCell<VecDeque<(u64, AnswerHead)>>,
        asked: Cell<ObservationHead>,
    }

    impl Script {
        fn new() -> Self {
            Self {
                now_ns: Cell::new(START_NS),
                answers: RefCell::default(),
                asked: Cell::default(),
            }
        }

        /// An answer to an observation comes so long after the start.
        fn answer(&self, after_ns: u64, seq: u64, action: i32, flags: u16) {
            self.come(after_ns, AnswerHead { seq, action, flags, ..Default::default() });
        }

        fn come(&self, after_ns: u64, answer: AnswerHead) {
            let head = AnswerHead { session: SESSION, ..answer };
            self.answers.borrow_mut().push_back((START_NS + after_ns, head));
        }

        fn passed_ns(&self) -> u64 {
            self.now_ns.get() - START_NS
        }
    }

    impl Clock for Script {
        fn now_ns(&self) -> u64 {
            self.now_ns.get()
        }
    }

    impl Line for Script {
        fn send(
            &self,
            write: impl FnOnce(&mut [u8]) -> Result<(), MessageError>,
        ) -> Result<(), Error> {
            let mut bytes = AlignedBytes::zeroed(format().observation_bytes());
            write(bytes.as_mut_slice()).unwrap();
            self.asked.set(*format().read_observation(bytes.as_slice()).unwrap().head);
            Ok(())
        }

        fn receive<T>(&self, read: impl FnOnce(&[u8]) -> T) -> Option<T> {
            let mut answers = self.answers.borrow_mut();
            answers.front().filter(|(at_ns, _)| *at_ns <= self.now_ns.get())?;
            let (_, head) = answers.pop_front()?;
            let mut bytes = AlignedBytes::zeroed(format().answer_bytes());
            format().write_answer(&head, &OUTPUTS, bytes.as_mut_slice()).unwrap();
            Some(read(bytes.as_slice()))
        }

        fn token(&self) -> u32 {
            0
        }

        fn wait(&self, _: u32, until_ns: u64) -> Wake {
            let comes_ns = self.answers.borrow().front().map(|(at_ns, _)| *at_ns);
            let rung_ns = comes_ns.filter(|at_ns| *at_ns <= until_ns);
            self.now_ns.set(rung_ns.unwrap_or(until_ns));
            if rung_ns.is_some() { Wake::Rung } else { Wake::Timeout }
        }
    }

    fn asking(deadline_ms: u64) -> Asking {
        Asking::new(format(), Duration::from_millis(deadline_ms), Fallback::Hold, SESSION)
    }

    /// What is done where both actions are available: how, why, which, and whether a state was lost.
    fn decide(asking: &mut Asking, script: &Script) -> (AnswerStatus, Reason, Option<u16>, bool) {
        let action = asking.decide(script, &[&[0.5]], &[1, 1], &mut || true).unwrap();
        (action.status, action.reason, action.action, action.lost_state)
    }

    const SILENT: (AnswerStatus, Reason) = (AnswerStatus::Fallback, Reason::Silence);

    #[test]
    fn an_answer_is_waited_for_until_the_deadline_and_no_longer() {
        let (mut asking, script) = (asking(250), Script::new());
        let mut heartbeats = 0;
        let mut goes_on = || {
            heartbeats += 1;
            true
        };
        let action = asking.decide(&script, &[&[0.5]], &[1, 1], &mut goes_on).unwrap();
        assert_eq!((action.status, action.reason), SILENT);
        assert_eq!((script.passed_ns(), heartbeats), (250 * MS, 2));
        // The server is told the same.
        assert_eq!(script.asked.get().deadline_ns, START_NS + 250 * MS);
        // One that comes with the deadline counts, one that comes behind it does not.
        asking.set_deadline(Duration::from_millis(30));
        script.answer(280 * MS, 2, 1, 0);
        assert_eq!(
            decide(&mut asking, &script),
            (AnswerStatus::Answered, Reason::None, Some(1), false)
        );
        script.answer(310 * MS + 1, 3, 0, 0);
        let (status, reason, action, _) = decide(&mut asking, &script);
        assert_eq!((status, reason, action), (SILENT.0, SILENT.1, Some(1)));
        assert_eq!(script.passed_ns(), 310 * MS);
        let ClientCounters { answered, silent, fallbacks, .. } = asking.counters();
        assert_eq!((answered, silent, fallbacks), (1, 2, 2));
    }

    #[test]
    fn who_goes_on_no_longer_is_let_go_at_the_next_heartbeat() {
        let (mut asking, script) = (asking(3_600_000), Script::new());
        let asked = asking.decide(&script, &[&[0.5]], &[1, 1], &mut || false);
        assert!(matches!(asked, Err(Error::Interrupted)));
        assert_eq!(script.passed_ns(), HEARTBEAT_NS);
    }

    #[test]
    fn an_action_that_is_not_available_is_the_fallback() {
        let (mut asking, script) = (asking(30), Script::new());
        for (seq, answered, available, done) in [
            (1, 1, [1, 1], (AnswerStatus::Answered, Some(1))),
            (2, 1, [1, 0], (AnswerStatus::Fallback, Some(0))),
            (3, 2, [1, 1], (AnswerStatus::Fallback, Some(0))),
            (4, -1, [0, 1], (AnswerStatus::Fallback, Some(1))),
            (5, -1, [0, 0], (AnswerStatus::Answered, None)),
            (6, 0, [0, 0], (AnswerStatus::Fallback, None)),
        ] {
            script.answer(seq, seq, answered, 0);
            let action = asking.decide(&script, &[&[0.5]], &available, &mut || true).unwrap();
            assert_eq!((action.status, action.action), done, "{answered} of {available:?}");
            let is_fallback = action.status == AnswerStatus::Fallback;
            assert_eq!(action.reason, if is_fallback { Reason::Policy } else { Reason::None });
        }
        assert_eq!((asking.counters().answered, asking.counters().fallbacks), (2, 4));
    }

    #[test]
    fn what_the_server_says_of_its_answer_is_told_and_counted() {
        use AnswerStatus::{Answered, Fallback as FallenBack, Late, Refused};
        let (mut asking, script) = (asking(30), Script::new());
        let mut seq = 0;
        let mut ask = |status: AnswerStatus, reason: Reason| {
            seq += 1;
            let (status, reason) = (status as u16, reason as u16);
            script.come(seq, AnswerHead { seq, status, reason, action: 1, ..Default::default() });
            let action = asking.decide(&script, &[&[0.5]], &[1, 1], &mut || true).unwrap();
            (action.status, action.reason, action.action, action.outputs.to_vec())
        };
        // What is refused has no outputs: those that were done last are done once more.
        let (none, both) = (vec![0.0; 2], OUTPUTS.to_vec());
        let refused = ask(Refused, Reason::Length);
        assert_eq!(refused, (FallenBack, Reason::Length, Some(0), none));
        assert_eq!(ask(Late, Reason::None), (Late, Reason::None, Some(1), both.clone()));
        assert_eq!(ask(Refused, Reason::Foreign).2, Some(1));
        let fallen = ask(FallenBack, Reason::NonFinite);
        assert_eq!(fallen, (FallenBack, Reason::NonFinite, Some(1), both.clone()));
        assert_eq!(ask(Answered, Reason::None), (Answered, Reason::None, Some(1), both));
        let met = asking.counters();
        let want = ClientCounters { answered: 2, late: 1, fallbacks: 3, ..Default::default() };
        assert_eq!(met, want);
    }

    #[test]
    fn the_guard_that_the_server_names_is_told_and_counted() {
        let (mut asking, script) = (asking(30), Script::new());
        let trip = Trip::OutputRate { index: 1 };
        let mut seq = 0;
        let mut ask = |status: AnswerStatus, reason: Reason, flags, action| {
            seq += 1;
            let (status, reason, guard) = (status as u16, reason as u16, trip.number());
            let head =
                AnswerHead { seq, status, reason, flags, guard, action, ..Default::default() };
            script.come(seq, head);
            let action = asking.decide(&script, &[&[0.5]], &[1, 0], &mut || true).unwrap();
            (action.status, action.reason, action.guard)
        };
        let fallen = (AnswerStatus::Fallback, Reason::Guard);
        assert_eq!(ask(fallen.0, fallen.1, 0, 0), (fallen.0, fallen.1, Some(trip)));
        let clamped = (AnswerStatus::Answered, Reason::None);
        let flags = AnswerHead::CLAMPED;
        assert_eq!(ask(clamped.0, clamped.1, flags, 0), (clamped.0, clamped.1, Some(trip)));
        // Its own fallback is nothing that a guard has made.
        let own = (AnswerStatus::Fallback, Reason::Policy, None);
        assert_eq!(ask(fallen.0, fallen.1, 0, 1), own);
        let ClientCounters { answered, fallbacks, guarded, clamped, .. } = asking.counters();
        assert_eq!((answered, fallbacks, guarded, clamped), (1, 2, 1, 1));
    }

    #[test]
    fn every_episode_has_another_number() {
        let (mut asking, script) = (asking(30), Script::new());
        let mut episode = || {
            decide(&mut asking, &script);
            asking.begin_episode();
            script.asked.get().episode
        };
        assert_eq!([episode(), episode(), episode()], [0, 1, 2]);
    }

    /// A new episode's first answer begins with a new state, which nobody has lost.
    #[test]
    fn what_comes_of_an_earlier_episode_says_nothing_of_this_ones_state() {
        let (mut asking, script) = (asking(30), Script::new());
        assert_eq!(decide(&mut asking, &script).0, AnswerStatus::Fallback);
        asking.begin_episode();
        script.answer(31 * MS, 1, 0, ANEW);
        script.answer(32 * MS, 2, 1, ANEW);
        let (status, _, action, lost_state) = decide(&mut asking, &script);
        assert_eq!((status, action, lost_state), (AnswerStatus::Answered, Some(1), false));
        // In the midst of an episode it is one that was lost; that is said once.
        script.answer(33 * MS, 3, 1, ANEW);
        assert!(decide(&mut asking, &script).3);
        script.answer(34 * MS, 4, 1, 0);
        assert!(!decide(&mut asking, &script).3);
        let ClientCounters { overdue, lost_states, .. } = asking.counters();
        assert_eq!((overdue, lost_states), (1, 1));
    }
}
