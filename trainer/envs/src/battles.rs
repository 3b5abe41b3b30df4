//! What battles share, whatever rules they are fought by: teams by their names, and ways on a plane.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

/// A place or a way, east and north.
pub(crate) type Point = [f32; 2];

/// The types of a team's units.
pub(crate) type Team = Vec<u8>;

/// Most units of both teams.
pub(crate) const CAPACITY: usize = 64;

/// The ways that units can be told to go, in the order of these actions.
pub(crate) const WAYS: [Point; 4] = [[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]];

/// The teams that a name such as `2s3z` or `5m_vs_6m` stands for, where each type has a letter.
pub(crate) fn meeting(name: &str, letters: &[char]) -> Option<[Team; 2]> {
    let (allies, enemies) = name.split_once("_vs_").unwrap_or((name, name));
    Some([team(allies, letters)?, team(enemies, letters)?])
}

/// Its units in the order of the name.
fn team(name: &str, letters: &[char]) -> Option<Team> {
    let mut team = Team::new();
    for run in name.split_inclusive(|sign: char| !sign.is_ascii_digit()) {
        let kind = letters.iter().position(|letter| run.ends_with(*letter))?;
        let count: usize = run[..run.len() - 1].parse().ok().filter(|count| *count <= CAPACITY)?;
        team.resize(team.len() + count, kind as u8);
    }
    Some(team)
}

/// What two teams are called, such as `5m_vs_6m`, or `2s3z` where both are the same.
pub(crate) fn meeting_name(teams: &[Team; 2], letters: &[char]) -> String {
    let [allies, enemies] = teams.each_ref().map(|team| -> String {
        let runs = team.chunk_by(|one, next| one == next);
        runs.map(|run| format!("{}{}", run.len(), letters[usize::from(run[0])])).collect()
    });
    if allies == enemies { allies } else { format!("{allies}_vs_{enemies}") }
}

#[inline]
pub(crate) fn length([x, y]: Point) -> f32 {
    libm::sqrtf(x * x + y * y)
}

/// Which of [`WAYS`] goes there best, the first of several.
pub(crate) fn heading([x, y]: Point) -> usize {
    let gains = [y, x, -y, -x];
    (1..gains.len()).fold(0, |best, way| if gains[way] > gains[best] { way } else { best })
}
