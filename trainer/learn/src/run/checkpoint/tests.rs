use super::*;

/// A network of two tensors.
fn tensors() -> Vec<Tensor> {
    let tensor = |name: &str, shape: [usize; 2], range| Tensor {
        name: name.to_owned(),
        shape: shape.to_vec(),
        range,
    };
    vec![tensor("fc1.weight", [4, 3], 0..12), tensor("fc1.bias", [1, 4], 12..16)]
}

fn write(checkpoints: &Checkpoints, env_steps: u64) -> PathBuf {
    let vector: Vec<f32> = (0..16).map(|number| (env_steps + number) as f32).collect();
    let part = |tensor: Tensor| {
        let name = format!("agents/average/{}", tensor.name);
        (name, tensor.shape, in_bytes(&vector[tensor.range]))
    };
    let mut written = Written::default();
    written.tensors.extend(tensors().into_iter().map(part));
    written.tensors.push(("mixer/online".to_owned(), vec![1, 2], in_bytes(&[1.5, 2.5])));
    for (name, value) in [("steps", env_steps), ("more", 1 << 40)] {
        written.values.insert(name.to_owned(), postcard::to_stdvec(&value).unwrap());
    }
    written.values.insert("long".to_owned(), vec![7; 300]);
    checkpoints.write(env_steps, &written).unwrap()
}

fn steps_of(found: &Found) -> u64 {
    let values: BTreeMap<String, Vec<u8>> = found.checkpoint.state().unwrap();
    assert_eq!((values.len(), &values["long"]), (3, &vec![7; 300]));
    let state: u64 = postcard::from_bytes(&values["steps"]).unwrap();
    assert_eq!(state, found.checkpoint.env_steps());
    let vector = found.checkpoint.vector("agents/average", &tensors()).unwrap();
    assert_eq!((vector.len(), vector[0]), (16, state as f32));
    state
}

#[test]
fn the_newest_is_read_back_and_two_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoints = Checkpoints::new(folder.path());
    assert!(checkpoints.newest(OpenFor::Use).unwrap_err().to_string().contains("no checkpoint"));
    for env_steps in [10, 20, 100] {
        write(&checkpoints, env_steps);
    }
    let found = checkpoints.newest(OpenFor::Use).unwrap();
    assert_eq!(steps_of(&found), 100);
    assert!(found.refused.is_empty());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    let missing = found.checkpoint.vector("agents/target", &tensors()).unwrap_err();
    let whole = |count| found.checkpoint.whole_vector("mixer/online", count);
    assert_eq!(whole(2).unwrap(), [1.5, 2.5]);
    assert!(whole(3).unwrap_err().to_string().contains("another size"));
    assert!(missing.to_string().contains("agents/target/fc1"), "{missing}");
}

#[test]
fn a_half_cut_file_is_refused_and_the_one_before_is_used() {
    for name in [TENSORS, STATE, MANIFEST] {
        let folder = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::new(folder.path());
        write(&checkpoints, 1);
        let newest = write(&checkpoints, 2).join(name);
        let content = std::fs::read(&newest).unwrap();
        std::fs::write(&newest, &content[..content.len() / 2]).unwrap();
        for purpose in [OpenFor::Use, OpenFor::Resume] {
            let found = checkpoints.newest(purpose).unwrap();
            assert_eq!(steps_of(&found), 1);
            assert_eq!(found.refused.len(), 1, "{name}");
            assert!(found.refused[0].contains(name), "{}", found.refused[0]);
        }
    }
}

#[test]
fn a_changed_byte_is_found_where_it_matters() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoints = Checkpoints::new(folder.path());
    write(&checkpoints, 1);
    let state = write(&checkpoints, 2).join(STATE);
    let mut content = std::fs::read(&state).unwrap();
    content[0] ^= 1;
    std::fs::write(&state, content).unwrap();
    assert_eq!(steps_of(&checkpoints.newest(OpenFor::Resume).unwrap()), 1);
    assert_eq!(checkpoints.newest(OpenFor::Use).unwrap().checkpoint.env_steps(), 2);
}

#[test]
fn weights_that_are_not_finite_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoints = Checkpoints::new(folder.path());
    for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut written = Written::default();
        let numbers = in_bytes(&[1.0, f32::MAX, wrong]);
        written.tensors.push(("mixer/online".to_owned(), vec![1, 3], numbers));
        checkpoints.write(1, &written).unwrap();
        let found = checkpoints.newest(OpenFor::Use).unwrap();
        let refused = found.checkpoint.whole_vector("mixer/online", 3).unwrap_err().to_string();
        assert!(refused.ends_with("mixer/online: number 2 is not finite"), "{refused}");
        assert!(matches!(
            found.checkpoint.whole_vector("mixer/online", 3),
            Err(LearnError::Format { .. })
        ));
    }
}

#[test]
fn another_format_is_refused_by_its_number() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoints = Checkpoints::new(folder.path());
    let manifest = write(&checkpoints, 1).join(MANIFEST);
    let text = std::fs::read_to_string(&manifest).unwrap();
    std::fs::write(&manifest, text.replace("format = 6", "format = 9")).unwrap();
    let error = checkpoints.newest(OpenFor::Use).unwrap_err().to_string();
    assert!(error.contains("format 9") && error.contains("reads 6"), "{error}");
}

#[test]
fn networks_of_the_format_before_are_used_and_not_gone_on_from() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoints = Checkpoints::new(folder.path());
    let manifest = write(&checkpoints, 1).join(MANIFEST);
    let text = std::fs::read_to_string(&manifest).unwrap();
    let older = text.replace("format = 6", "format = 3") + "\n[shapes.agents]\nwidth = 4\n";
    std::fs::write(&manifest, older).unwrap();
    assert_eq!(checkpoints.newest(OpenFor::Use).unwrap().checkpoint.env_steps(), 1);
    let error = checkpoints.newest(OpenFor::Resume).unwrap_err().to_string();
    assert!(error.contains("format 3") && error.contains("goes on from 6"), "{error}");
}

#[test]
fn an_unfinished_checkpoint_does_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoints = Checkpoints::new(folder.path());
    write(&checkpoints, 1);
    std::fs::create_dir(folder.path().join("000000000002.unfinished")).unwrap();
    assert_eq!(steps_of(&checkpoints.newest(OpenFor::Use).unwrap()), 1);
}

#[test]
fn values_in_parts_are_a_map_of_postcard() {
    let values = BTreeMap::from([("steps", vec![1; 300]), ("a", vec![])]);
    let values = values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    let parts = in_parts(&values).unwrap();
    let written: Vec<u8> =
        parts.iter().flat_map(|(before, value)| [before.as_slice(), value].concat()).collect();
    assert_eq!(written, postcard::to_stdvec(&values).unwrap());
}
