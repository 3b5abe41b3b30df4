//! Sets by name, and sizes that the rules do not allow.

use sortie_envs::group_matching::{GroupMatching, Parameters, SET_NAMES};

#[test]
fn names_say_the_sizes() {
    assert_eq!(Parameters::named(SET_NAMES[0]), Ok(Parameters::default()));
    for name in SET_NAMES {
        Parameters::named(name).unwrap();
    }
    let set = Parameters::named("12x10x3-fixed").unwrap();
    assert_eq!((set.agents, set.cells, set.groups, set.fixed_groups), (12, 10, 3, true));
}

#[test]
fn other_names_and_sizes_are_refused_by_name() {
    for (name, want) in [
        ("8x6", "no set `8x6`; a set is named AGENTSxCELLSxGROUPS, such as `8x6x2`"),
        ("8x6x2x1", "no set `8x6x2x1`"),
        ("8x6x-2", "no set `8x6x-2`"),
        ("8x6x2-loose", "no set `8x6x2-loose`"),
        ("0x6x2", "0 agents are not possible: from 1 to 64 are"),
        ("8x257x2", "257 cells are not possible: from 1 to 256 are"),
        ("8x6x129", "129 groups are not possible: from 1 to 128 are"),
    ] {
        let error = Parameters::named(name).unwrap_err().to_string();
        assert!(error.starts_with(want), "{error}");
    }
    let refused = |parameters| GroupMatching::new(parameters, 1).unwrap_err().to_string();
    let noise = refused(Parameters { noise: 1.5, ..Parameters::default() });
    assert_eq!(noise, "the noise is not a probability from 0 to 1");
    let limit = refused(Parameters { episode_limit: 0, ..Parameters::default() });
    assert_eq!(limit, "an episode limit of 0 steps leaves no episode");
}
