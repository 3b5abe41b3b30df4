//! The flight recorder: nothing is written until something happens, then what was said before and shortly after.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::ValueEnum;
use signal_hook::consts::SIGUSR1;
use sortie_core::wire::{ActionMsg, Role, StatMsg};
use sortie_ipc::Heard;
use sortie_record::Recent;

use super::files::{Files, Open, SAID, full, said};
use super::log::Log;
use crate::failure::{Exit, Failure, Outcome};

/// How long a file goes on after what it is written for.
const AFTER_NS: u64 = 1_000_000_000;
/// How long a process may say nothing before it is taken for dead; it tells of itself ten times a second.
const SILENCE_NS: u64 = 1_500_000_000;

/// What a flight recorder writes for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Event {
    /// A policy refused, and its fallback acted
    Fallback,
    /// An action was sent after its deadline
    Late,
    /// A process has not said anything for a while, and had not taken its leave
    Death,
}

/// A record in memory.
pub(super) struct Flight {
    files: Files,
    recent: Recent,
    events: Vec<Event>,
    /// When processes were last heard, and what they are.
    heard: BTreeMap<u32, (u64, &'static str)>,
    /// What is to be written, and when.
    due: Option<(u64, String)>,
    /// Somebody sent the signal.
    is_asked: Arc<AtomicBool>,
}

impl Flight {
    /// Keeps the messages of so many nanoseconds.
    pub(super) fn new(files: Files, span_ns: u64, events: Vec<Event>) -> Result<Self, Failure> {
        let is_asked = Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(SIGUSR1, Arc::clone(&is_asked))
            .map_err(|error| Failure::new(Exit::InputOutput, format!("SIGUSR1: {error}")))?;
        let recent = Recent::new(span_ns + AFTER_NS);
        Ok(Self { files, recent, events, heard: BTreeMap::new(), due: None, is_asked })
    }

    /// Judges a message that was read at this time.
    pub(super) fn hear(&mut self, heard: Heard<'_>, now_ns: u64) {
        match heard {
            Heard::Action(it) => {
                for (event, flag, what) in [
                    (Event::Fallback, ActionMsg::GUARD, "a guard refused what it observed"),
                    (Event::Fallback, ActionMsg::FALLBACK, "its policy refused"),
                    (Event::Late, ActionMsg::LATE, "its action was late"),
                ] {
                    if it.has(flag) {
                        let (agent, tick) = (it.agent, it.tick as u32);
                        self.happened(event, now_ns, || {
                            format!("agent {agent}, tick {tick}: {what}")
                        });
                    }
                }
            }
            Heard::Status(it) if it.has(StatMsg::BYE) => {
                self.heard.remove(&it.pid);
            }
            Heard::Status(it) => {
                let role = Role::from_number(it.role).map_or("process", Role::name);
                self.heard.insert(it.pid, (now_ns, role));
            }
            Heard::Frame(..) | Heard::Allocation(_) => {}
        }
    }

    /// What comes while something waits to be written goes with it.
    fn happened(&mut self, event: Event, now_ns: u64, why: impl FnOnce() -> String) {
        if self.due.is_none() && self.events.contains(&event) {
            self.due = Some((now_ns + AFTER_NS, why()));
        }
    }

    /// Keeps what was added, and writes what is due.
    pub(super) fn look(&mut self, log: &mut Log, now_ns: u64) -> Outcome {
        self.recent.keep(&mut log.writer, now_ns);
        let silent = |(at_ns, _): &(u64, &str)| now_ns.saturating_sub(*at_ns) > SILENCE_NS;
        let gone: Vec<_> = self.heard.extract_if(.., |_, heard| silent(heard)).collect();
        for (pid, (_, role)) in gone {
            self.happened(Event::Death, now_ns, || format!("{role} {pid} fell silent"));
        }
        if self.is_asked.swap(false, Ordering::Relaxed) {
            self.due = Some((now_ns, "somebody asked".to_owned()));
        }
        match self.due.take_if(|(at_ns, _)| *at_ns <= now_ns) {
            Some((_, why)) => self.save(log, why),
            None => Ok(()),
        }
    }

    fn save(&mut self, log: &mut Log, why: String) -> Outcome {
        let Open { path, mut file } = self.files.create()?;
        let missed = log.end_file();
        let said = said(missed, Some(&why));
        let saved = self.recent.save(&mut log.writer, &mut file, (SAID, &said));
        saved.map_err(|error| full(&path, &error))?;
        self.files.close(path, missed, Some(why))
    }

    /// Writes what waits to be, and nothing else.
    pub(super) fn end(mut self, log: &mut Log) -> Outcome {
        if let Some((_, why)) = self.due.take() {
            self.save(log, why)?;
        }
        self.files.wait()
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use sortie_core::wire::FrameHeader;
    use zerocopy::FromZeros;

    use super::*;
    use crate::output::Common;
    use crate::record::files::Division;

    #[derive(Parser)]
    struct Nothing {
        #[command(flatten)]
        common: Common,
    }

    fn flight(events: Vec<Event>) -> Flight {
        let division = Division { path: "run.mcap".into(), is_numbered: true, keep: None };
        let files = Files::new(division, Nothing::parse_from(["test"]).common);
        Flight::new(files, 10, events).expect("signals can be listened to")
    }

    fn action(flags: u16) -> ActionMsg {
        ActionMsg { agent: 3, tick: 7 << 32 | 812, flags, ..ActionMsg::new_zeroed() }
    }

    #[test]
    fn it_writes_for_what_was_chosen_and_for_the_first_of_it() {
        let frame = FrameHeader::default();
        let fallback = action(ActionMsg::FALLBACK | ActionMsg::STALE_ALLOC);
        let late = action(ActionMsg::LATE);
        for (events, why) in [
            (vec![Event::Fallback], Some("agent 3, tick 812: its policy refused")),
            (vec![Event::Late], Some("agent 3, tick 812: its action was late")),
            (vec![Event::Late, Event::Fallback], Some("agent 3, tick 812: its action was late")),
            (vec![Event::Death], None),
        ] {
            let mut flight = flight(events);
            flight.hear(Heard::Frame(&frame, &[]), 1);
            flight.hear(Heard::Action(&action(ActionMsg::STALE_ALLOC)), 2);
            flight.hear(Heard::Action(&late), 3);
            flight.hear(Heard::Action(&fallback), 4);
            let due = flight.due.as_ref().map(|(_, why)| &**why);
            assert_eq!(due, why);
        }
    }

    #[test]
    fn who_takes_leave_is_not_dead() {
        let mut flight = flight(vec![Event::Death]);
        let status = |pid, flags| StatMsg { pid, flags, ..StatMsg::new_zeroed() };
        for pid in [1, 2] {
            flight.hear(Heard::Status(&status(pid, 0)), 5);
        }
        flight.hear(Heard::Status(&status(1, StatMsg::BYE)), 6);
        assert_eq!(flight.heard.keys().collect::<Vec<_>>(), [&2]);
    }
}
