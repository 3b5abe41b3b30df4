//! A bundle comes back as it was written, and every change to it is noticed and named.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use sortie_core::allocate::PointingRules;
use sortie_core::{EntityMask, limits};

use crate::files::MOST_BYTES;
use crate::{
    AGENT, ALLOCATOR, AgentGraph, Bundle, BundleError, CARD, CONTRACT_ABI, ContractV1, Draft,
    Environment, FallbackAllocation, GOLDEN, Golden, GoldenAllocation, GoldenCase, GoldenValue,
    Limits, MANIFEST, MIN_ALLOCATIONS, MIN_CASES, Network, OwnedAllocationState, OwnedObservation,
    POINTING, POINTING_PARTS, POLICY, PROPOSAL_PARTS, PROPOSALS, PointingContract,
    SubtaskConditioning, TEAM_VALUE, hex, sha256,
};

fn draft() -> Draft {
    let contract = ContractV1 {
        abi: CONTRACT_ABI,
        actions: 2,
        features: 1,
        feature_names: vec!["distance".into()],
        action_names: vec!["stay".into(), "go".into()],
        decision_interval: 5,
        append_last_action: false,
        subtask_conditioning: SubtaskConditioning::Mask,
        subtask_actions: false,
        safe_action: None,
        fallback_allocation: FallbackAllocation::Heuristic,
    };
    let case = |index: usize| GoldenCase {
        observation: OwnedObservation {
            rows: vec![index as f32 / 7.0, 1.0],
            features: 1,
            last_actions: vec![],
            visible: EntityMask::first(2),
            self_index: 0,
            available: vec![1, 1],
        },
        utilities: vec![0.5, -0.25],
        action: 0,
    };
    let environment = Environment {
        name: "test-world".into(),
        version: "1".into(),
        feature_units: vec!["m".into()],
        feature_ranges: vec![[0.0, 10.0]],
    };
    let parts = [(AGENT, b"network".as_slice()), (CARD, b"# A card")];
    Draft {
        contract,
        environment,
        limits: Limits { n_max: 11, t_max: 6, team_max: 3 },
        network: Network { agent: "masked-attention".into(), ..Network::default() },
        golden: Golden { cases: (0..MIN_CASES).map(case).collect(), ..Golden::default() },
        parts: parts.map(|(name, bytes)| (name.to_owned(), bytes.to_vec())).into(),
    }
}

/// A draft with a learned allocator.
fn draft_with_allocator() -> Draft {
    let mut draft = draft();
    let allocation = GoldenAllocation {
        state: OwnedAllocationState {
            agents: 1,
            tasks: 1,
            rows: vec![0.5, 0.25],
            features: 1,
            present: EntityMask::first(2),
            entity_task: vec![0, 1],
            open_tasks: 1,
            available: Vec::new(),
        },
        relations: 0,
        relation: vec![],
        values: vec![GoldenValue { task: 0, team: 1, value: 0.75 }],
        allocation: vec![0],
    };
    draft.golden.allocations = vec![allocation; MIN_ALLOCATIONS];
    draft.network.allocator = Some(TEAM_VALUE.into());
    draft.parts.insert(ALLOCATOR.into(), b"team values".to_vec());
    draft
}

fn message(folder: &Path) -> String {
    Bundle::open(folder).map(|_| ()).unwrap_err().to_string()
}

#[test]
fn comes_back_as_it_was_written() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("city");
    let written = draft().write(&folder).unwrap();
    let bundle = Bundle::open(&folder).unwrap();
    assert_eq!(bundle.id(), written.id());
    assert_eq!(*bundle.id(), sha256(&fs::read(folder.join(MANIFEST)).unwrap()));
    assert_eq!(bundle.contract(), &draft().contract);
    assert_eq!(bundle.manifest().contract.environment, draft().environment);
    assert_eq!(bundle.golden(), &draft().golden);
    assert_eq!(bundle.agent_onnx(), b"network");
    assert_eq!(bundle.part(CARD), Some(b"# A card".as_slice()));
    assert_eq!(fs::read_dir(home.path()).unwrap().count(), 1, "no draft is left behind");
}

#[test]
fn a_learned_allocator_comes_back_and_is_never_half_there() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("city");
    let bundle = draft_with_allocator().write(&folder).unwrap();
    assert_eq!(bundle.allocator_onnx(), Some(b"team values".as_slice()));
    assert_eq!(bundle.golden().allocations, draft_with_allocator().golden.allocations);
    assert_eq!(draft().write(&home.path().join("plain")).unwrap().allocator_onnx(), None);

    let path = folder.join(MANIFEST);
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("\"team-value\"", "\"oracle\"")).unwrap();
    assert!(message(&folder).contains("allocator `oracle` is not known: update sortie"));
    let without: Vec<&str> = text.lines().filter(|line| !line.contains(ALLOCATOR)).collect();
    fs::write(&path, without.join("\n")).unwrap();
    assert!(message(&folder).contains("allocator_team_value.onnx` is missing"));

    let mut few = draft_with_allocator();
    few.golden.allocations.truncate(MIN_ALLOCATIONS - 1);
    let mut nameless = draft_with_allocator();
    nameless.network.allocator = None;
    for bad in [few, nameless] {
        let refused = bad.write(&home.path().join("other"));
        assert!(matches!(refused, Err(BundleError::Invalid { .. })));
    }
}

#[test]
fn a_proposing_allocator_comes_back_and_is_never_half_there() {
    let home = tempfile::tempdir().unwrap();
    let mut proposing = draft();
    proposing.network.allocator = Some(PROPOSALS.into());
    let mut half = proposing.clone();
    for name in PROPOSAL_PARTS {
        proposing.parts.insert(name.into(), name.as_bytes().to_vec());
    }
    let bundle = proposing.write(&home.path().join("city")).unwrap();
    assert_eq!(bundle.proposal_graphs(), Some(PROPOSAL_PARTS.map(str::as_bytes)));
    assert_eq!((bundle.has_allocator(), bundle.allocator_onnx()), (true, None));
    half.parts.insert(PROPOSAL_PARTS[0].into(), vec![1]);
    let mut other = proposing.clone();
    other.network.allocator = None;
    for bad in [half, other] {
        let refused = bad.write(&home.path().join("other"));
        assert!(matches!(refused, Err(BundleError::Invalid { .. })));
    }
}

#[test]
fn an_allocator_that_points_comes_back_with_what_it_can_give() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("routes");
    let mut pointing = draft_with_allocator();
    pointing.parts.remove(ALLOCATOR);
    pointing.network.allocator = Some(POINTING.into());
    pointing.network.pointing = Some(PointingContract { exclusive: vec![0, 4], first_action: 1 });
    for name in POINTING_PARTS {
        pointing.parts.insert(name.into(), name.as_bytes().to_vec());
    }
    let bundle = pointing.write(&folder).unwrap();
    let rules = PointingRules { exclusive: 0b1_0001, first_action: 1 };
    assert_eq!(bundle.pointing_graphs(), Some((POINTING_PARTS.map(str::as_bytes), rules)));
    assert_eq!((bundle.manifest().format, bundle.allocator_onnx()), (4, None));
    assert_eq!(draft().write(&home.path().join("plain")).unwrap().pointing_graphs(), None);

    let refused = |change: fn(&mut Draft)| {
        let mut bad = pointing.clone();
        change(&mut bad);
        bad.write(&home.path().join("other")).unwrap_err().to_string()
    };
    let told = |words: &str, change: fn(&mut Draft)| {
        let error = refused(change);
        assert!(error.contains(words), "{error}");
    };
    told("needs its rules", |bad| bad.network.pointing = None);
    told("needs its rules", |bad| bad.network.allocator = Some(TEAM_VALUE.into()));
    told("an allocator needs its kind", |bad| drop(bad.parts.remove(POINTING_PARTS[1])));
    told("allocations, at least", |bad| bad.golden.allocations.clear());
    fn given(exclusive: Vec<u8>, first_action: u16) -> Option<PointingContract> {
        Some(PointingContract { exclusive, first_action })
    }
    told("first_action is 2, there are 2", |bad| bad.network.pointing = given(vec![0], 2));
    told("names subtask 32", |bad| bad.network.pointing = given(vec![3, 32], 0));
}

/// A draft of a team with two roles, the second of which may not go.
fn draft_of_roles() -> Draft {
    let mut draft = draft();
    let graph = |name: &str, actions| AgentGraph { name: name.into(), features: 1, actions };
    let graphs = vec![graph("rover", 2), graph("tower", 1)];
    draft.network =
        Network { agent: POLICY.into(), graph_of: vec![0, 1, 1], graphs, ..Network::default() };
    for (index, case) in draft.golden.cases.iter_mut().enumerate() {
        case.observation.rows.push(0.5);
        case.observation.self_index = index % 3;
    }
    draft.parts.remove(AGENT);
    for name in ["rover", "tower"] {
        draft.parts.insert(format!("agent-{name}.onnx"), name.into());
    }
    draft
}

#[test]
fn the_graphs_of_several_roles_come_back() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("towers");
    let bundle = draft_of_roles().write(&folder).unwrap();
    let graphs = bundle.agent_graphs();
    assert_eq!(graphs, draft_of_roles().network.graphs);
    assert_eq!(bundle.graph_onnx(&graphs[1]), b"tower");
    assert_eq!(graphs[1].plan_part(), "agent-tower.plan");
    assert_eq!((bundle.manifest().format, bundle.agent_onnx()), (2, &b""[..]));
    let alike = draft().write(&home.path().join("city")).unwrap();
    let [of_all] = &alike.agent_graphs()[..] else { panic!("one graph") };
    assert_eq!((of_all.onnx_part().as_str(), of_all.actions), (AGENT, 2));
    assert_eq!((alike.manifest().format, alike.graph_onnx(of_all)), (1, &b"network"[..]));

    fs::remove_file(folder.join("agent-tower.onnx")).unwrap();
    assert!(message(&folder).contains("agent-tower.onnx` is missing"));
}

#[test]
fn graphs_that_do_not_fit_the_team_are_refused_in_words() {
    let home = tempfile::tempdir().unwrap();
    let refused = |change: fn(&mut Draft)| {
        let mut draft = draft_of_roles();
        change(&mut draft);
        draft.write(&home.path().join("towers")).unwrap_err().to_string()
    };
    let told = |words: &str, change: fn(&mut Draft)| {
        let error = refused(change);
        assert!(error.contains(words), "{error}");
    };
    told("agent-rover.onnx", |draft| drop(draft.parts.remove("agent-rover.onnx")));
    told("`tower` has 3 actions, a row has 2", |draft| draft.network.graphs[1].actions = 3);
    told("`rover` has 0 features, a row has 1", |draft| draft.network.graphs[0].features = 0);
    told("graph_of names graph 2, there are 2", |draft| draft.network.graph_of[0] = 2);
    told("no agent decides by the graph `tower`", |draft| draft.network.graph_of = vec![0; 3]);
    told("need names, each another", |draft| draft.network.graphs[1].name = "rover".into());
    told("all decide by one graph", |draft| draft.network.agent = "masked-attention".into());
    told("an agent that is none of 2", |draft| draft.network.graph_of.truncate(2));
    told("no case is of an agent that decides by the graph `rover`", |draft| {
        draft.golden.cases.iter_mut().for_each(|case| case.observation.self_index = 1);
    });
    let at_most = "at most 64 are possible";
    told(at_most, |draft| draft.network.graph_of = [0, 1].repeat(33));

    let folder = home.path().join("edited");
    draft_of_roles().write(&folder).unwrap();
    let path = folder.join(MANIFEST);
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("actions = 1", "actions = 9")).unwrap();
    let edited = message(&folder);
    assert!(edited.contains("`tower` has 9 actions, a row has 2, in [network]"), "{edited}");
}

#[test]
fn the_same_draft_gives_the_same_id() {
    let home = tempfile::tempdir().unwrap();
    let ids = ["a", "b"].map(|name| *draft().write(&home.path().join(name)).unwrap().id());
    assert_eq!(ids[0], ids[1]);
}

#[test]
fn every_changed_or_missing_file_is_named() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("city");
    draft().write(&folder).unwrap();
    for name in [AGENT, CARD, GOLDEN] {
        let path = folder.join(name);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, [bytes.as_slice(), b" "].concat()).unwrap();
        let changed = message(&folder);
        assert!(changed.contains(name) && changed.contains("was changed"), "{changed}");
        assert!(changed.contains(&hex(&sha256(&bytes))), "{changed}");
        fs::remove_file(&path).unwrap();
        let missing = message(&folder);
        assert!(missing.contains(name) && missing.contains("is missing"), "{missing}");
        fs::write(&path, bytes).unwrap();
    }
    assert!(Bundle::open(&folder).is_ok());
}

#[test]
fn a_file_that_is_larger_than_any_bundles_is_refused() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("city");
    draft().write(&folder).unwrap();
    for name in [AGENT, GOLDEN, MANIFEST] {
        let path = folder.join(name);
        let file = fs::File::options().write(true).open(&path).unwrap();
        let length = file.metadata().unwrap().len();
        // Nothing is written: what lies behind the content is a hole.
        file.set_len(MOST_BYTES + 1).unwrap();
        match Bundle::open(&folder) {
            Err(BundleError::TooLarge { path: named, bytes, max }) => {
                assert_eq!((named, bytes, max), (path, MOST_BYTES + 1, MOST_BYTES));
            }
            other => panic!("{name}: {other:?}"),
        }
        file.set_len(length).unwrap();
    }
    assert!(Bundle::open(&folder).is_ok());
}

#[test]
fn an_edited_manifest_is_refused_with_its_reason() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("city");
    draft().write(&folder).unwrap();
    let path = folder.join(MANIFEST);
    let text = fs::read_to_string(&path).unwrap();
    let refused = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        fs::write(&path, text.replace(from, to)).unwrap();
        message(&folder)
    };
    assert!(refused("format = 1", "format = 6").contains("update sortie"));
    assert!(refused("decision_interval = 5", "decision_interval = 6").contains("was edited"));
    assert!(refused("\"distance\"", "\"distance\", \"x\"").contains("2 feature names for 1"));
    assert!(refused("\"card.md\"", "\"../card.md\"").contains("not a plain file name"));
    assert!(refused("n_max = 11", "n_max = \"many\"").contains("cannot be read"));
    assert!(refused("n_max = 11", "n_max = 0").contains("nothing is seen"));
    for (limit, most) in [
        ("n_max = 11", limits::ENTITIES),
        ("t_max = 6", limits::TASKS),
        ("team_max = 3", limits::AGENTS),
    ] {
        let (name, _) = limit.split_once(' ').unwrap();
        let beyond = refused(limit, &format!("{name} = {}", most + 1));
        assert!(beyond.contains(&format!("{name} = {} in [limits]", most + 1)), "{beyond}");
        fs::write(&path, text.replace(limit, &format!("{name} = {most}"))).unwrap();
        assert!(Bundle::open(&folder).is_ok(), "{limit}");
    }
}

#[test]
fn what_is_not_a_bundle_is_said_so() {
    let home = tempfile::tempdir().unwrap();
    assert!(matches!(Bundle::open(home.path()), Err(BundleError::NotABundle { .. })));
    let absent = home.path().join("nowhere");
    assert!(message(&absent).contains("nowhere"));
}

#[test]
fn a_bundle_is_never_overwritten_nor_half_written() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("city");
    draft().write(&folder).unwrap();
    assert!(matches!(draft().write(&folder), Err(BundleError::Exists { .. })));
    let other = home.path().join("other");
    let mut few = draft();
    few.golden.cases.truncate(MIN_CASES - 1);
    let mut nameless = draft();
    nameless.parts = BTreeMap::new();
    let mut outside = draft();
    outside.parts.insert("../outside".into(), vec![]);
    for bad in [few, nameless, outside] {
        assert!(matches!(bad.write(&other), Err(BundleError::Invalid { .. })));
        assert!(!other.exists());
    }
}
