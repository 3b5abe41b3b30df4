//! What is signed is taken, and everything else is refused by name.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use ed25519_compact::{KeyPair, Seed};
use sortie_bundle::{
    AGENT, AGENT_PLAN, Bundle, CARD, CONTRACT_ABI, ContractV1, Draft, FallbackAllocation, GOLDEN,
    Golden, GoldenCase, Limits, MANIFEST, MIN_CASES, Network, OwnedObservation,
    SubtaskConditioning, hex,
};
use sortie_core::EntityMask;
use sortie_core::signature::from_hex;

use crate::{
    BundleSignature, FOLDER, NamedKey, REVOKED, Revoked, SecretKey, SignError, Trust,
    bundle_signature_files, key_files, plan_signatures_of, revoke, sign_bundle, sign_plan,
    signature_file, with_checksum,
};

/// How often something signed is changed at random. Ten times as many take minutes, and were tried.
const CHANGES: u64 = 1_000;

/// A signed bundle, a signed plan, and keys of whom one is revoked.
struct Scene {
    home: tempfile::TempDir,
}

impl Scene {
    fn new() -> Self {
        let scene = Self { home: tempfile::tempdir().unwrap() };
        draft().write(&scene.bundle()).unwrap();
        fs::write(scene.plan(), b"a plan, for all that signatures know").unwrap();
        for name in ["me", "lost"] {
            SecretKey::create(&scene.pair(name)).unwrap();
        }
        revoke(&key_files(&scene.pair("lost"))[1], "left in a train").unwrap();
        scene.sign("me");
        scene
    }

    fn path(&self, name: &str) -> PathBuf {
        self.home.path().join(name)
    }

    fn bundle(&self) -> PathBuf {
        self.path("bundle")
    }

    fn plan(&self) -> PathBuf {
        self.path("walking.plan")
    }

    fn pair(&self, name: &str) -> PathBuf {
        self.path("keys").join(name)
    }

    /// The only signature of the bundle.
    fn signature(&self) -> PathBuf {
        bundle_signature_files(&self.bundle()).unwrap().remove(0)
    }

    fn sign(&self, name: &str) {
        let secret = SecretKey::read(&self.pair(name)).unwrap();
        sign_bundle(&secret, &Bundle::open(&self.bundle()).unwrap()).unwrap();
        sign_plan(&secret, &self.plan(), &fs::read(self.plan()).unwrap()).unwrap();
    }

    fn unsign(&self) {
        fs::remove_dir_all(self.bundle().join(FOLDER)).unwrap();
        fs::remove_file(signature_file(&self.plan())).unwrap();
    }

    /// Who has signed the bundle and the plan.
    fn signers(&self, trust: &Trust) -> [Result<String, SignError>; 2] {
        let bundle = Bundle::open(&self.bundle()).unwrap();
        let plan = fs::read(self.plan()).unwrap();
        let name = |key: &NamedKey| key.name.clone();
        [trust.check_bundle(&bundle).map(name), trust.check_plan(&self.plan(), &plan).map(name)]
    }

    /// Why both are refused.
    fn refusals(&self) -> [SignError; 2] {
        self.signers(&Trust::read(&self.path("keys")).unwrap()).map(|signer| signer.unwrap_err())
    }

    /// Whether all files are as they were: what refuses them says so.
    fn whole(&self) -> Result<(), String> {
        let text = |error: SignError| error.to_string();
        SecretKey::read(&self.pair("me")).map_err(text)?;
        let trust = Trust::read(&self.path("keys")).map_err(text)?;
        let bundle = Bundle::open(&self.bundle()).map_err(|error| error.to_string())?;
        trust.check_bundle(&bundle).map_err(text)?;
        let plan = fs::read(self.plan()).unwrap();
        trust.check_plan(&self.plan(), &plan).map_err(text)?;
        Ok(())
    }

    /// Every file of the scene that counts.
    fn files(&self) -> Vec<PathBuf> {
        let of_bundle =
            [MANIFEST, AGENT, AGENT_PLAN, CARD, GOLDEN].map(|name| self.bundle().join(name));
        let others = [
            self.signature(),
            self.plan(),
            signature_file(&self.plan()),
            self.path("keys/me.key"),
            self.path("keys/me.pub"),
            self.path("keys/lost.pub"),
            self.path("keys").join(REVOKED),
        ];
        of_bundle.into_iter().chain(others).collect()
    }
}

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
    let observation = OwnedObservation {
        rows: vec![0.5, 1.0],
        features: 1,
        last_actions: vec![],
        visible: EntityMask::first(2),
        self_index: 0,
        available: vec![1, 1],
    };
    let case = GoldenCase { observation, utilities: vec![0.5, -0.25], action: 0 };
    let parts = [(AGENT, b"network".as_slice()), (AGENT_PLAN, b"its plan"), (CARD, b"# A card")];
    Draft {
        contract,
        environment: Default::default(),
        limits: Limits { n_max: 11, t_max: 6, team_max: 3 },
        network: Network { agent: "masked-attention".into(), ..Network::default() },
        golden: Golden { cases: vec![case; MIN_CASES], ..Golden::default() },
        parts: parts.map(|(name, bytes)| (name.to_owned(), bytes.to_vec())).into(),
    }
}

#[test]
fn signatures_are_those_of_rfc_8032() {
    // Section 7.1: secret key, public key, message, signature.
    let tests = [
        [
            "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60",
            "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a",
            "",
            "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555fb8821590a33bacc61e39701cf9b46bd25bf5f0595bbe24655141438e7a100b",
        ],
        [
            "4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb",
            "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c",
            "72",
            "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00",
        ],
        [
            "c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7",
            "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025",
            "af82",
            "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a",
        ],
    ];
    for [secret, public, message, signature] in tests {
        let pair = KeyPair::from_seed(Seed::new(from_hex(secret).unwrap()));
        let bytes = (0..message.len()).step_by(2).map(|at| from_hex::<1>(&message[at..at + 2]));
        let message: Vec<u8> = bytes.map(|byte| byte.unwrap()[0]).collect();
        assert_eq!(hex(&*pair.pk), public);
        let signed = pair.sk.sign(&message, None);
        assert_eq!(hex(&*signed), signature);
        assert!(pair.pk.verify(&message, &signed).is_ok());
    }
}

#[test]
fn signing_changes_nothing_but_that_it_is_signed() {
    let scene = Scene::new();
    scene.unsign();
    let before = *Bundle::open(&scene.bundle()).unwrap().id();
    assert!(scene.refusals().iter().all(|error| matches!(error, SignError::Unsigned { .. })));
    scene.sign("me");
    assert_eq!(*Bundle::open(&scene.bundle()).unwrap().id(), before);
    // A folder, and one of its keys.
    for trusted in [scene.path("keys"), scene.path("keys/me.pub")] {
        let signers = scene.signers(&Trust::read(&trusted).unwrap());
        assert_eq!(signers.map(|signer| signer.unwrap()), ["me", "me"]);
    }
    // The same again: nothing is added.
    let text = fs::read(scene.signature()).unwrap();
    scene.sign("me");
    assert_eq!(fs::read(scene.signature()).unwrap(), text);
    assert_eq!(plan_signatures_of(&scene.plan()).unwrap().len(), 1);
}

#[test]
fn keys_are_secret_and_are_never_replaced() {
    let scene = Scene::new();
    let [secret, public] = key_files(&scene.pair("me"));
    assert_eq!(key_files(&secret), [secret.clone(), public.clone()]);
    assert_eq!(key_files(&public), [secret.clone(), public.clone()]);
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!((mode(&secret), mode(&public) & 0o444), (0o600, 0o444));
    let again = SecretKey::create(&scene.pair("me")).unwrap_err();
    assert!(matches!(again, SignError::Exists { path } if path == secret));
    fs::remove_file(&secret).unwrap();
    let again = SecretKey::create(&scene.pair("me")).unwrap_err();
    assert!(matches!(again, SignError::Exists { path } if path == public));
    assert!(!secret.exists(), "no half of a pair is left");
    for name in ["a b", ".hidden", "a/../é"] {
        let refused = SecretKey::create(&scene.pair(name)).unwrap_err();
        assert!(matches!(refused, SignError::Name { .. }), "{name}");
    }
    // Two keys are two keys.
    let [one, other] = ["one", "other"].map(|name| SecretKey::new(name).unwrap().public().key);
    assert_ne!(one, other);
}

#[test]
fn a_secret_key_that_others_can_read_signs_nothing() {
    let scene = Scene::new();
    let [secret, _] = key_files(&scene.pair("me"));
    for mode in [0o640, 0o604, 0o620, 0o601] {
        fs::set_permissions(&secret, fs::Permissions::from_mode(mode)).unwrap();
        let refused = SecretKey::read(&scene.pair("me")).err().unwrap();
        assert!(matches!(refused, SignError::Open { mode: told, .. } if told == mode), "{mode:o}");
    }
    fs::set_permissions(&secret, fs::Permissions::from_mode(0o400)).unwrap();
    assert!(SecretKey::read(&scene.pair("me")).is_ok());
}

#[test]
fn keys_that_are_none_are_refused_whatever_their_checksum() {
    let path = Path::new("file");
    let scene = Scene::new();
    let [text, public] = key_files(&scene.pair("me")).map(|file| fs::read_to_string(file).unwrap());
    let secret = SecretKey::from_text(path, &text).unwrap();
    let other = hex(&SecretKey::from_seed("me", [2; 32]).unwrap().public().key.0);
    let own = hex(&secret.public().key.0);
    let forged = |text: &str, from: &str, to: &str| {
        assert!(text.contains(from));
        with_checksum(&text.split("# check").next().unwrap().replace(from, to))
    };
    let refused = SecretKey::from_text(path, &forged(&text, &own, &other)).err().unwrap();
    assert!(refused.to_string().contains("its two keys are no pair"), "{refused}");
    let name = forged(&text, "\"me\"", "\"no/name\"");
    assert!(matches!(SecretKey::from_text(path, &name), Err(SignError::Name { .. })));
    // One of small order, with which anybody could sign.
    let weak = forged(&public, &own, &format!("01{}", "0".repeat(62)));
    for text in [weak, forged(&public, "\"me\"", "\"no/name\""), forged(&public, &own, "00")] {
        let refused = NamedKey::from_text(path, &text).unwrap_err();
        assert!(refused.to_string().contains("its name or its key is none"), "{refused}");
    }
    let more = NamedKey::from_text(path, &forged(&public, "name", "more = 1\nname"));
    assert!(matches!(more, Err(SignError::Damaged { .. })));
}

#[test]
fn a_key_is_followed_by_another_and_revoked() {
    let scene = Scene::new();
    SecretKey::create(&scene.pair("next")).unwrap();
    scene.sign("next");
    assert_eq!(bundle_signature_files(&scene.bundle()).unwrap().len(), 2);
    assert_eq!(plan_signatures_of(&scene.plan()).unwrap().len(), 2);
    // Whoever trusts either takes it.
    for name in ["me", "next"] {
        let [_, public] = key_files(&scene.pair(name));
        let signers = scene.signers(&Trust::read(&public).unwrap());
        assert_eq!(signers.map(|signer| signer.unwrap()), [name, name]);
    }
    revoke(&scene.path("keys/me.pub"), "replaced").unwrap();
    let signers = scene.signers(&Trust::read(&scene.path("keys")).unwrap());
    assert_eq!(signers.map(|signer| signer.unwrap()), ["next", "next"]);
    // The list counts for a single file of its folder, and for keys that are gone from it.
    let old = Trust::read(&scene.path("keys/me.pub")).unwrap();
    for refused in scene.signers(&old).map(|signer| signer.unwrap_err()) {
        assert!(
            matches!(refused, SignError::Revoked { ref name, ref reason, .. } if name == "me" && reason == "replaced"),
            "{refused}"
        );
    }
    assert_eq!(
        fs::read_to_string(scene.path("keys").join(REVOKED)).unwrap().matches("name = ").count(),
        2
    );
    // Signed anew after a change, with what does not count any more left out.
    fs::write(scene.plan(), "another plan").unwrap();
    scene.sign("next");
    assert_eq!(plan_signatures_of(&scene.plan()).unwrap().len(), 1);
}

#[test]
fn what_nobody_signed_who_is_trusted_is_refused() {
    let scene = Scene::new();
    scene.unsign();
    scene.sign("lost");
    for refused in scene.refusals() {
        assert!(
            matches!(refused, SignError::Revoked { ref name, .. } if name == "lost"),
            "{refused}"
        );
    }
    scene.unsign();
    let strangers = scene.path("strangers/me");
    SecretKey::create(&strangers).unwrap();
    let stranger = SecretKey::read(&strangers).unwrap();
    sign_bundle(&stranger, &Bundle::open(&scene.bundle()).unwrap()).unwrap();
    sign_plan(&stranger, &scene.plan(), &fs::read(scene.plan()).unwrap()).unwrap();
    for refused in scene.refusals() {
        assert!(matches!(refused, SignError::Unknown { .. }), "{refused}");
    }
    let nobody = scene.path("nobody");
    fs::create_dir(&nobody).unwrap();
    assert!(matches!(Trust::read(&nobody).unwrap_err(), SignError::NoKeys { .. }));
    let nowhere = Trust::read(&scene.path("nowhere")).unwrap_err();
    assert!(matches!(nowhere, SignError::Missing { .. }));
}

#[test]
fn what_was_changed_or_forged_is_refused() {
    let scene = Scene::new();
    // The signature of another bundle.
    let other = Draft { parts: [(AGENT.to_owned(), b"other".to_vec())].into(), ..draft() };
    fs::rename(scene.bundle(), scene.path("signed")).unwrap();
    other.write(&scene.bundle()).unwrap();
    fs::rename(scene.path("signed").join(FOLDER), scene.bundle().join(FOLDER)).unwrap();
    fs::write(scene.plan(), "another plan").unwrap();
    let [bundle, plan] = scene.refusals();
    assert!(matches!(bundle, SignError::OtherBundle { .. }), "{bundle}");
    assert!(matches!(plan, SignError::Forged { .. }), "{plan}");
    // The same with the id of this one, and a right checksum.
    let text = fs::read_to_string(scene.signature()).unwrap();
    let id = hex(Bundle::open(&scene.bundle()).unwrap().id());
    let lines = text.lines().filter(|line| !line.starts_with("# check")).map(|line| match line {
        line if line.starts_with("bundle") => format!("bundle = \"{id}\"\n"),
        line => format!("{line}\n"),
    });
    fs::write(scene.signature(), with_checksum(&lines.collect::<String>())).unwrap();
    let [bundle, _] = scene.refusals();
    assert!(matches!(bundle, SignError::Forged { .. }), "{bundle}");
}

#[test]
fn files_of_a_newer_program_are_told_from_damaged_ones() {
    let scene = Scene::new();
    for file in [scene.signature(), scene.path("keys/me.pub"), scene.path("keys").join(REVOKED)] {
        let text = fs::read_to_string(&file).unwrap();
        fs::write(&file, text.replace("format = 1", "format = 2\nnew = true")).unwrap();
        let refused = scene.whole().unwrap_err();
        assert!(refused.contains("has format 2, this program reads 1"), "{refused}");
        fs::write(&file, text).unwrap();
    }
    assert_eq!(scene.whole(), Ok(()));
    let many = scene.bundle().join(FOLDER);
    for number in 0..64 {
        fs::write(many.join(format!("{number}.toml")), "").unwrap();
    }
    assert!(scene.whole().unwrap_err().contains("65 files, at most 64 are read"));
}

#[test]
fn every_changed_byte_of_every_file_is_refused_by_name() {
    let scene = Scene::new();
    assert_eq!(scene.whole(), Ok(()));
    for file in scene.files() {
        let content = fs::read(&file).unwrap();
        // All alike inside: the golden cases, of which each stands there again and again.
        for byte in (0..content.len()).step_by(1 + content.len() / 700) {
            let mut changed = content.clone();
            changed[byte] ^= 1;
            fs::write(&file, changed).unwrap();
            let refused = scene.whole();
            assert!(refused.is_err_and(|reason| !reason.is_empty()), "byte {byte} of {file:?}");
        }
        fs::write(&file, content).unwrap();
    }
    assert_eq!(scene.whole(), Ok(()));
}

/// Numbers that look random, the same each time.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, limit: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % limit
    }

    /// Changes one place or several, of any kind.
    fn change(&mut self, content: &mut Vec<u8>) {
        for _ in 0..=self.below(3) {
            let at = self.below(content.len().max(1)).min(content.len());
            let until = (at + self.below(40)).min(content.len());
            match self.below(6) {
                0 => content.truncate(at),
                1 => content.insert(at, self.below(256) as u8),
                2 => drop(content.drain(at..until)),
                3 => content.extend_from_within(at..until),
                _ if at < content.len() => content[at] = self.below(256) as u8,
                _ => content.push(b'0'),
            }
        }
    }
}

#[test]
fn whatever_is_changed_at_random_is_refused_by_name() {
    let scene = Scene::new();
    let files = scene.files();
    let (mut numbers, mut refused, mut reasons) = (Numbers(1), 0, BTreeSet::new());
    while refused < CHANGES {
        let file = &files[numbers.below(files.len())];
        let content = fs::read(file).unwrap();
        let mut changed = content.clone();
        numbers.change(&mut changed);
        if changed != content {
            fs::write(file, &changed).unwrap();
            let reason = scene.whole().expect_err(&format!("change {refused} of {file:?}"));
            reasons.insert(reason);
            fs::write(file, content).unwrap();
            refused += 1;
        }
    }
    assert_eq!(scene.whole(), Ok(()));
    assert!(reasons.len() > 10, "{reasons:?}");
}

#[test]
fn whatever_is_forged_at_random_is_refused_or_says_the_same() {
    let scene = Scene::new();
    let path = Path::new("forged");
    let signature = fs::read_to_string(scene.signature()).unwrap();
    let key = fs::read_to_string(scene.path("keys/me.pub")).unwrap();
    let list = fs::read_to_string(scene.path("keys").join(REVOKED)).unwrap();
    let trust = Trust::read(&scene.path("keys")).unwrap();
    let bundle = Bundle::open(&scene.bundle()).unwrap();
    let mut numbers = Numbers(2);
    let mut forged = |text: &str| {
        let mut bytes = text.split("# check").next().unwrap().as_bytes().to_vec();
        numbers.change(&mut bytes);
        with_checksum(&String::from_utf8_lossy(&bytes))
    };
    let said = BundleSignature::from_text(path, &signature).unwrap();
    for _ in 0..CHANGES {
        let text = forged(&signature);
        fs::write(scene.signature(), &text).unwrap();
        if trust.check_bundle(&bundle).is_ok() {
            assert_eq!(BundleSignature::from_text(path, &text).unwrap(), said, "{text}");
        }
        // What was read is written so that it is read again.
        if let Ok(key) = NamedKey::from_text(path, &forged(&key)) {
            assert_eq!(NamedKey::from_text(path, &key.to_text()).unwrap(), key);
        }
        if let Ok(list) = Revoked::from_text(path, &forged(&list)) {
            assert_eq!(Revoked::from_text(path, &Revoked::to_text(&list)).unwrap(), list);
        }
    }
}
