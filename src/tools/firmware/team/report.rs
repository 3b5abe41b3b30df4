//! What became of a team of which one agent is a board.

use serde::Serialize;
use sortie_bundle::Bundle;
use sortie_cli::failure::{Failure, Outcome};
use sortie_cli::output::{Table, plural, say};
use sortie_cli::worlds::tally::Tally;
use sortie_learn::evaluate::wilson_interval;

use super::device::Counted;
use super::line::Carried;
use super::play::Played;
use crate::firmware::FirmwareArguments;
use crate::firmware::toolchain::Toolchain;

#[derive(Clone, Debug, Serialize)]
pub(super) struct Ran {
    board: String,
    bundle: String,
    profile: &'static str,
    /// The compiler's version.
    compiler: String,
    agent: usize,
    /// One in so many; 0 = none.
    damage: u32,
    disorder: u32,
}

impl Ran {
    pub(super) fn new(
        arguments: &FirmwareArguments,
        bundle: &Bundle,
        toolchain: &Toolchain,
        agent: usize,
    ) -> Self {
        let name = bundle.folder().file_name().unwrap_or_default().to_string_lossy();
        Self {
            board: arguments.board.name(),
            bundle: name.into_owned(),
            profile: arguments.profile().name(),
            compiler: toolchain.version.clone(),
            agent,
            damage: arguments.team.damage.unwrap_or(0),
            disorder: arguments.team.disorder.unwrap_or(0),
        }
    }
}

/// The summary; scripts rely on its names.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Report {
    #[serde(flatten)]
    ran: Ran,
    episodes: usize,
    success: f64,
    success_ci95: [f64; 2],
    return_mean: f64,
    /// Frames that asked the board for an action, and those of them that it decided on.
    frames: u64,
    frames_arrived: u64,
    /// Actions of the board that the world executed; for the other frames it played the fallback action.
    actions_executed: u64,
    /// Those that differ from what this machine's runtime decides on the same frame.
    wrong_actions: u64,
    resets: u64,
    /// What one end was given and did not count.
    uncounted: u64,
    to_board: Carried,
    board_counted: Counted,
    from_board: Carried,
    relay_counted: Relayed,
}

/// What the relay and the world counted of what came from the board.
#[derive(Clone, Copy, Debug, Serialize)]
struct Relayed {
    packets: u64,
    torn: u64,
    corrupt: u64,
    too_long: u64,
    refused: u64,
    /// Actions for an earlier frame.
    late: u64,
    bad: u64,
}

impl Report {
    pub(super) fn new(ran: Ran, tally: &Tally, played: &Played) -> Self {
        let Tally { episodes, solved, returns, .. } = *tally;
        let Played { line, relay, world, turns } = played;
        Self {
            ran,
            episodes,
            success: solved as f64 / episodes.max(1) as f64,
            success_ci95: wilson_interval(solved, episodes),
            return_mean: returns / episodes.max(1) as f64,
            frames: turns.asked,
            frames_arrived: line.device.decided,
            actions_executed: turns.executed,
            wrong_actions: turns.wrong,
            resets: line.resets,
            uncounted: line.uncounted,
            to_board: line.down,
            board_counted: line.device,
            from_board: line.up,
            relay_counted: Relayed {
                packets: relay.packets,
                torn: relay.torn,
                corrupt: relay.corrupt,
                too_long: relay.too_long,
                refused: relay.refused,
                late: world.late,
                bad: world.bad_messages,
            },
        }
    }

    /// A failure where the board did what it should not.
    pub(super) fn verdict(&self) -> Outcome {
        match (self.wrong_actions, self.uncounted) {
            (0, 0) => Ok(()),
            (0, uncounted) => Err(Failure::difference(format!(
                "{uncounted} pieces of what came were not counted; please report this"
            ))),
            (wrong, _) => Err(Failure::difference(format!(
                "{wrong} actions of the board are not those of this machine's runtime; please report this"
            ))),
        }
    }

    pub(super) fn print(&self) {
        let Ran { board, bundle, profile, compiler, agent, .. } = &self.ran;
        say!("{bundle}, {profile}: agent {agent} is {board} (emulated), built by rustc {compiler}");
        let [low, high] = self.success_ci95;
        say!(
            "success {:.3} (95 % interval {low:.3} to {high:.3}) over {}, mean return {:.2}",
            self.success,
            plural(self.episodes, "episode"),
            self.return_mean
        );
        let share = 100.0 * self.frames_arrived as f64 / self.frames.max(1) as f64;
        say!(
            "{} frames asked the board, {} arrived ({share:.1} %), {} actions executed, {} WRONG, {}",
            self.frames,
            self.frames_arrived,
            self.actions_executed,
            self.wrong_actions,
            plural(self.resets as usize, "reset"),
        );
        let stale = self.board_counted;
        say!(
            "decisions of the board by an earlier allocation {}, without one {}\n",
            stale.stale,
            stale.unallocated
        );
        self.print_line();
        say!("\n{} pieces of what came were not counted", self.uncounted);
    }

    fn print_line(&self) {
        let mut table = Table::new(&["the line", "to the board", "from the board"]);
        let (down, up) = (&self.to_board, &self.from_board);
        let (board, relay) = (&self.board_counted, &self.relay_counted);
        let rows = [
            ("packets sent", down.packets, up.packets),
            ("bytes sent", down.bytes, up.bytes),
            ("  changed", down.changed, up.changed),
            ("  lost", down.lost, up.lost),
            ("  doubled", down.doubled, up.doubled),
            ("packets torn on the way", down.torn, up.torn),
            ("  repeated", down.repeated, up.repeated),
            ("  overtaken", down.overtaken, up.overtaken),
            ("packets taken", board.packets, relay.packets),
            ("refused: torn", board.torn, relay.torn),
            ("  corrupt", board.corrupt, relay.corrupt),
            ("  too long", board.too_long, relay.too_long),
            ("  not of this domain", board.refused + board.foreign, relay.refused),
            ("  impossible", board.bad, relay.bad),
            ("  repeated or overtaken", board.old + board.overtaken, relay.late),
        ];
        for (name, down, up) in rows {
            table.row([name.to_owned(), down.to_string(), up.to_string()]);
        }
        table.print();
    }
}
