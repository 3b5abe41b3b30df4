//! Made-up messages, and what is told of them.

use sortie_core::plan::AlignedBytes;
use sortie_core::wire::{
    ABI, ActionMsg, AllocMsg, FrameFormat, FrameHeader, FrameKind, FrameMut, Role, StatMsg,
};
use sortie_core::{EntityMask, Shape, UNASSIGNED};
use sortie_ipc::{DomainContract, DomainFacts, Heard};
use sortie_pages::Canvas;
use zerocopy::FromZeros;

use super::lines::View;
use super::overview::{Overview, Percentiles, Standing};
use super::team::Team;

const SHAPE: Shape = Shape { agents: 3, entities: 4, tasks: 2, actions: 5, features: 2 };
const MS: u64 = 1_000_000;
/// When somebody begins to listen, and the time from frame to frame.
const BEGAN_NS: u64 = 5_000 * MS;
const PERIOD_NS: u64 = 10 * MS;
const TERM: u64 = 2 << 32;

/// A team of which one tells what one likes.
struct Tale {
    team: Team,
    format: FrameFormat,
    now_ns: u64,
    tick: u64,
    /// The numbers of frames, and of each process's actions.
    seq: u64,
    acted: [u64; 3],
    /// What agents did last.
    done: [u16; 3],
}

impl Tale {
    fn new() -> Self {
        let period = std::time::Duration::from_nanos(PERIOD_NS);
        let contract = DomainContract { allocation: Some("learned".into()), ..Default::default() };
        let facts = DomainFacts::new(&contract, SHAPE).with_period(period);
        let team = Team::new("north", &facts, BEGAN_NS).expect("a format");
        let format = facts.format().expect("a format");
        Self { team, format, now_ns: BEGAN_NS, tick: TERM, seq: 0, acted: [0; 3], done: [0; 3] }
    }

    /// The next frame, in which these agents exist and these are absent.
    fn frame(&mut self, agents: &[usize], absent: u64, flags: u16) {
        self.now_ns += PERIOD_NS;
        self.tick += 1;
        self.seq += 1;
        let bytes = self.format.layout.payload_bytes();
        let mut payload = AlignedBytes::zeroed(bytes);
        let payload = payload.as_mut_slice();
        let mut frame = FrameMut::new(payload, self.format.layout).expect("there is room");
        let mut present = EntityMask::default();
        agents.iter().for_each(|agent| present.insert(*agent));
        frame.set_present(&present);
        frame.set_progress((self.tick - TERM - 1) as u32, self.tick, absent);
        for (agent, done) in self.done.iter().enumerate() {
            frame.set_last_action(agent, *done);
        }
        let header = FrameHeader {
            magic: FrameHeader::MAGIC,
            abi: ABI,
            kind: FrameKind::World as u16,
            schema: self.format.schema,
            seq: self.seq,
            tick: self.tick,
            t_ns: self.now_ns,
            len: bytes as u32,
            flags,
            world_term: 2,
            episode: 4,
            ..FrameHeader::new_zeroed()
        };
        self.team.hear(Heard::Frame(&header, payload), self.now_ns);
    }

    /// An agent's answer to the newest frame, which it then does, by the process of 100 and its number.
    fn answer(&mut self, agent: u16, flags: u16, decide_us: u32) {
        let acted = &mut self.acted[usize::from(agent)];
        *acted += 1;
        self.done[usize::from(agent)] = agent + 1;
        let action = ActionMsg {
            seq: *acted,
            tick: self.tick,
            t_ns: self.now_ns + MS,
            agent,
            action: agent + 1,
            flags,
            task: if agent == 0 { 1 } else { UNASSIGNED },
            q: 0.25,
            decide_ns: decide_us * 1000,
            runner: 100 + u32::from(agent),
            ..ActionMsg::new_zeroed()
        };
        self.team.hear(Heard::Action(&action), self.now_ns + MS);
    }

    fn status(&mut self, role: Role, pid: u32, flags: u32, t_ns: u64) {
        let agents = if role == Role::Runner { 1 << (pid - 100) } else { 0 };
        let model = if role == Role::World { [0; 16] } else { [0xAB; 16] };
        let (start_ns, seq) = (t_ns - 1_500 * MS, t_ns);
        let told = StatMsg {
            seq,
            pid,
            role: role as u8,
            flags,
            agents,
            model,
            t_ns,
            start_ns,
            ..StatMsg::new_zeroed()
        };
        self.team.hear(Heard::Status(&told), t_ns);
    }

    fn allocation(&mut self, term: u32, epoch: u32) {
        let told = AllocMsg {
            seq: epoch.into(),
            term,
            epoch,
            tick: self.tick,
            t_ns: self.now_ns,
            decide_ns: 245_000,
            ..AllocMsg::new_zeroed()
        };
        self.team.hear(Heard::Allocation(&told), self.now_ns);
    }

    fn overview(&self) -> Overview {
        self.team.overview(self.now_ns)
    }

    /// Of each agent: how often it was asked, fell back and was late.
    fn totals(&self) -> Vec<[u64; 3]> {
        let agents = self.overview().agents;
        agents.iter().map(|it| [it.asked_total, it.fallbacks_total, it.late_total]).collect()
    }
}

#[test]
fn whoever_does_not_answer_in_time_has_fallen_back() {
    let mut tale = Tale::new();
    for _ in 0..10 {
        // Agent 2 has no part in the episode.
        tale.frame(&[0, 1, 3], 0, 0);
        tale.answer(0, 0, 100);
    }
    tale.answer(1, ActionMsg::LATE, 100);
    tale.frame(&[0, 1, 3], 0b10, 0);
    tale.answer(0, ActionMsg::FALLBACK, 100);
    tale.answer(1, ActionMsg::LATE, 100);
    // The world was not late, and did not wait for it.
    tale.done[1] = 0;
    // A tick is judged when two others have begun; an episode's last frame asks for nothing.
    assert_eq!(tale.totals(), [[9, 0, 0], [9, 9, 2], [0, 0, 0]]);
    tale.frame(&[0, 1, 3], 0b10, FrameHeader::EPISODE_END);
    assert_eq!(tale.totals(), [[10, 0, 0], [10, 9, 2], [0, 0, 0]]);
    tale.frame(&[0, 1, 3], 0b10, 0);
    assert_eq!(tale.totals(), [[11, 1, 0], [11, 10, 2], [0, 0, 0]]);
    tale.frame(&[0, 1, 3], 0b10, 0);
    assert_eq!(tale.totals(), [[11, 1, 0], [11, 10, 2], [0, 0, 0]]);
    let agents = tale.overview().agents;
    let standings = [Standing::Plays, Standing::Absent, Standing::Missing];
    assert_eq!(agents.iter().map(|it| it.standing).collect::<Vec<_>>(), standings);
    assert_eq!(agents[1].fallback_share, Some(10.0 / 11.0));
    assert_eq!(agents[1].late_share, Some(2.0 / 11.0));
    assert_eq!((agents[2].fallback_share, agents[2].action), (None, None));
    assert_eq!((agents[0].action, agents[0].subtask), (Some(1), Some(1)));
    assert_eq!((agents[1].action, agents[1].subtask), (Some(2), None));
    // Of an episode that was given up nobody knows the end, and the next one is without agent 0.
    tale.frame(&[1, 3], 0b10, FrameHeader::EPISODE_START);
    tale.frame(&[1, 3], 0b10, 0);
    assert_eq!(tale.totals(), [[12, 2, 0], [12, 11, 2], [0, 0, 0]]);
    let first = tale.overview().agents.swap_remove(0);
    let told = (first.standing, first.action, first.process);
    assert_eq!(told, (Standing::Missing, None, Some(100)));
}

#[test]
fn what_was_not_heard_is_missed_and_nobody_fell_back_by_it() {
    let mut tale = Tale::new();
    tale.frame(&[0], 0, 0);
    tale.answer(0, 0, 100);
    tale.frame(&[0], 0, 0);
    // Its answer is lost, which its next one shows.
    tale.acted[0] += 1;
    for _ in 0..3 {
        tale.frame(&[0], 0, 0);
        tale.answer(0, 0, 100);
    }
    // So are two frames.
    (tale.seq, tale.tick) = (tale.seq + 2, tale.tick + 2);
    tale.frame(&[0], 0, 0);
    let told = tale.overview();
    assert_eq!(told.missed_total, 3);
    assert_eq!(told.agents[0].fallbacks_total, 0);
    assert_eq!(told.ticks_total, 7, "from the first frame to the last");
}

#[test]
fn figures_are_those_of_the_last_seconds() {
    let mut tale = Tale::new();
    for tick in 0..2_000 {
        tale.frame(&[0], 0, 0);
        if tick < 500 {
            continue;
        }
        tale.answer(0, 0, if tick < 1_200 || tick % 20 == 0 { 900 } else { 100 });
        tale.allocation(1, tick);
        // Said once more.
        tale.allocation(1, tick);
    }
    let told = tale.overview();
    // Twenty seconds after it began: nine whole ones and the tenth, which has just begun.
    assert!((told.window_s - 9.0).abs() < 0.02, "{told:?}");
    assert!((told.ticks_per_s - 100.0).abs() < 0.5, "{told:?}");
    let allocation = told.allocation.expect("an allocation");
    assert!((allocation.per_s - 100.0).abs() < 0.5 && allocation.total == 1_500, "{told:?}");
    assert_eq!((allocation.age_ticks, allocation.decide_us), (0, 245.0));
    assert_eq!(told.agents[0].fallback_share, Some(0.0));
    assert_eq!(told.agents[0].fallbacks_total, 500);
    let Percentiles { p50, p99 } = told.agents[0].decide_us.expect("decisions");
    assert!((99.0..101.0).contains(&p50) && (890.0..910.0).contains(&p99), "{p50} {p99}");
}

#[test]
fn who_was_killed_is_silent_and_leads_no_more() {
    let mut tale = Tale::new();
    tale.frame(&[0], 0, 0);
    tale.allocation(1, 1);
    let now_ns = tale.now_ns;
    tale.status(Role::Allocator, 7, StatMsg::LEADER, now_ns);
    tale.status(Role::Allocator, 8, 0, now_ns);
    tale.status(Role::Runner, 100, 0, now_ns);
    tale.answer(0, 0, 100);
    assert_eq!(tale.overview().agents[0].process, Some(100));
    tale.now_ns += 2_000 * MS;
    let now_ns = tale.now_ns;
    tale.allocation(2, 1);
    tale.status(Role::Allocator, 8, StatMsg::LEADER, now_ns);
    let bye = ActionMsg { flags: ActionMsg::BYE, runner: 100, ..ActionMsg::new_zeroed() };
    tale.team.hear(Heard::Action(&bye), now_ns);
    let told = tale.overview();
    let seen: Vec<_> =
        told.processes.iter().map(|it| (it.pid, it.leads_in_term, it.silent_ms)).collect();
    assert_eq!(seen, [(100, None, 2_000), (7, None, 2_000), (8, Some(2), 0)]);
    assert_eq!(told.agents[0].process, None);
    tale.status(Role::Allocator, 8, StatMsg::BYE, now_ns);
    tale.now_ns += 8_000 * MS;
    assert_eq!(tale.overview().processes, []);
}

/// Three agents for a second: the last one is gone, and its process silent.
fn a_second() -> Overview {
    let mut tale = Tale::new();
    for tick in 0..100 {
        tale.frame(&[0, 1, 2], 0b100, 0);
        tale.answer(0, 0, 100);
        tale.answer(1, if tick % 10 == 0 { ActionMsg::LATE } else { 0 }, 90);
        if tick % 5 == 0 {
            tale.allocation(1, tick / 5 + 1);
        }
    }
    let now_ns = tale.now_ns;
    tale.status(Role::World, 90, StatMsg::LEADER | StatMsg::DEGRADED, now_ns);
    tale.status(Role::Allocator, 91, StatMsg::LEADER, now_ns);
    tale.status(Role::Runner, 100, StatMsg::GRAPH, now_ns);
    tale.status(Role::Runner, 101, 0, now_ns);
    tale.now_ns += 3 * MS;
    tale.status(Role::Runner, 102, 0, now_ns - 1_300 * MS);
    tale.overview()
}

fn shown(view: &mut View, (width, lines): (usize, usize)) -> String {
    let canvas = Canvas { width: width - 1, lines: lines - 1, is_unicode: false };
    let shown = view.lines(&a_second(), canvas, Some(false));
    let fits = shown.iter().all(|line| line.chars().count() < width);
    assert!(shown.len() < lines && fits, "{}", shown.join("\n"));
    shown.join("\n")
}

#[test]
fn a_wide_screen_shows_more_of_everybody_than_one_of_80_columns() {
    for size in [(80, 24), (120, 40)] {
        let path = format!("{}/top/screens/{}x{}.txt", env!("CARGO_MANIFEST_DIR"), size.0, size.1);
        let expected = std::fs::read_to_string(&path).unwrap_or_default();
        let shown = shown(&mut View::default(), size);
        assert_eq!(shown, expected.trim_end(), "{path}:\n{shown}\n");
    }
}

#[test]
fn what_does_not_fit_is_scrolled_to() {
    let mut told = a_second();
    told.agents =
        (0..40).map(|agent| super::overview::Agent { agent, ..told.agents[0].clone() }).collect();
    let canvas = Canvas { width: 79, lines: 23, is_unicode: false };
    let mut view = View::default();
    let first = view.lines(&told, canvas, Some(false));
    assert_eq!(first.len(), 23);
    assert!(first[22].ends_with("0 lines above, 30 below"), "{first:?}");
    view.scroll(5);
    let later = view.lines(&told, canvas, Some(true));
    assert_eq!((&later[..4], &later[4..17]), (&first[..4], &first[9..22]));
    assert!(later[22].starts_with("HELD") && later[22].ends_with("5 lines above, 25 below"));
    view.scroll(1_000);
    let last = view.lines(&told, canvas, None);
    assert!(last[21].starts_with("39 ") && last[22].starts_with("Ctrl-C"), "{last:?}");
    view.scroll(-30);
    assert_eq!(view.lines(&told, canvas, Some(false)), first);
}

#[test]
fn a_small_terminal_is_told_what_is_needed() {
    for (width, lines) in [(60, 24), (80, 20)] {
        let shown = shown(&mut View::default(), (width, lines));
        assert_eq!(shown, format!("80 by 24 are needed, here are {width} by {lines}"));
    }
}
