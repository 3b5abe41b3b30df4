//! Which agents share a process.

/// Deals agents to runners: one fewer than the cores, so that the world has one for itself, at
/// least one and at most one per agent. `isolate` gives each agent its own process.
pub fn group_agents(agents: usize, cores: usize, isolate: bool) -> Vec<Vec<u16>> {
    let most = agents.max(1);
    let runners = if isolate { most } else { cores.saturating_sub(1).clamp(1, most) };
    let mut groups = vec![Vec::new(); runners];
    // The limit of agents fits 16 bits.
    for (agent, runner) in (0..agents as u16).zip((0..runners).cycle()) {
        groups[runner].push(agent);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_a_core_to_the_world() {
        assert_eq!(group_agents(5, 2, false), [[0, 1, 2, 3, 4]]);
        assert_eq!(group_agents(5, 3, false), [vec![0, 2, 4], vec![1, 3]]);
        assert_eq!(group_agents(2, 16, false), [[0], [1]]);
        assert_eq!(group_agents(3, 1, false), [[0, 1, 2]]);
        assert_eq!(group_agents(3, 1, true), [[0], [1], [2]]);
    }
}
