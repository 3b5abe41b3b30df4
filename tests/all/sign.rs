//! What is started with `--trust` was signed by somebody who is trusted, in every process that loads it.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use serde_json::Value;

use crate::support::{
    BUNDLE, Ending as _, TestDomain, assert_fails, copied_bundle, interrupt, json, output, sortie,
    stderr, wait_until,
};

const CART: &str = "examples/embed_c/cart.plan";
/// The name of no domain: what should have been refused before fails there, and does not wait.
const NO_DOMAIN: [&str; 2] = ["--domain", "no domain"];

/// A team that plays until it is told to end, or until its test fails.
struct Playing(Child);

impl Drop for Playing {
    fn drop(&mut self) {
        // One that was shut down has ended.
        if matches!(self.0.try_wait(), Ok(None)) {
            interrupt(&self.0);
            let _ = self.0.wait();
        }
    }
}

/// A folder with a bundle, `better`, and a pair of keys, `keys/me`.
struct Signer {
    home: tempfile::TempDir,
}

impl Signer {
    fn new() -> Self {
        let signer = Self { home: tempfile::tempdir().expect("a folder") };
        copy(copied_bundle().path(), Path::new(&signer.path("better")));
        signer.done(&["sign", "--new", &signer.path("keys/me")]);
        signer
    }

    fn path(&self, name: &str) -> String {
        self.home.path().join(name).to_str().expect("text").to_owned()
    }

    fn done(&self, arguments: &[&str]) {
        let output = output(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    }

    fn sign(&self, subject: &str) {
        self.done(&["sign", &self.path("keys/me"), &self.path(subject)]);
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder");
    for entry in fs::read_dir(from).expect("a folder").flatten() {
        fs::copy(entry.path(), to.join(entry.file_name())).expect("a copy");
    }
}

/// The verbs that load a bundle for a team, or say something about it, each as short as it goes.
fn trusting<'a>(bundle: &'a str, keys: &'a str) -> [Vec<&'a str>; 4] {
    let runner = ["process", "runner", bundle, "--agents", "0", "--trust", keys];
    let verify = ["verify", bundle, "--inputs", "1", "--against", "golden", "--trust", keys];
    [
        vec!["run", bundle, "--in-process", "--episodes", "1", "--trust", keys],
        vec!["up", bundle, "--episodes", "1", "--rate", "0", "--trust", keys],
        // Refused before anybody waits for a team, of which there is none there.
        [&runner[..], &["--domain", "signed-nobody"]].concat(),
        verify.to_vec(),
    ]
}

#[test]
fn what_nobody_signed_is_refused_by_every_verb_that_is_told_whom_to_trust() {
    let signer = Signer::new();
    let (bundle, keys) = (signer.path("better"), signer.path("keys"));
    let refused = |code: i32, words: &[&str]| {
        for verb in trusting(&bundle, &keys) {
            assert_fails(&output(&verb), code, words);
        }
    };
    refused(77, &["better is not signed", "sortie sign KEY"]);
    signer.sign("better");
    signer.done(&["sign", "--revoke", &signer.path("keys/me"), "--reason", "laptop stolen"]);
    refused(77, &["signed with the key `me`, which is revoked: laptop stolen"]);
    fs::remove_file(signer.path("keys/revoked.toml")).expect("the list");
    signer.done(&["sign", "--new", &signer.path("others/me")]);
    fs::copy(signer.path("others/me.pub"), signer.path("keys/me.pub")).expect("a copy");
    refused(77, &["is signed, but with no key of", "keys"]);
    fs::write(signer.path("keys/me.pub"), "edited").expect("a file");
    refused(65, &["me.pub", "never edited"]);
    fs::remove_file(signer.path("keys/me.pub")).expect("a key");
    refused(66, &["keys holds no public key"]);
}

#[test]
fn a_signed_bundle_is_taken_and_one_that_was_changed_since_is_not() {
    let signer = Signer::new();
    let (bundle, keys) = (signer.path("better"), signer.path("keys"));
    let [run, up, _, verify] = trusting(&bundle, &keys);
    let before = json(&["inspect", &bundle, "--json"]);
    signer.sign("better");
    assert_eq!(json(&["inspect", &bundle, "--json"]), before);
    signer.done(&run);
    let domain = TestDomain::new("signed");
    signer.done(&[&up[..], &["--quiet", "--domain", &domain.id]].concat());
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
    let verified = output(&verify);
    assert!(verified.status.success(), "{}", stderr(&verified));
    assert!(stderr(&verified).contains("note: signed by `me` (key "), "{}", stderr(&verified));
    let listed = json(&["sign", "--list", &bundle, "--json"]);
    let [ref me] = listed.as_array().expect("signatures")[..] else { panic!("{listed}") };
    assert!(me["key"].as_str().is_some_and(|key| key.len() == 64) && me["refused"].is_null());
    // Everything stands under the manifest, and the manifest is what is signed.
    let manifest = format!("{bundle}/bundle.toml");
    let text = fs::read_to_string(&manifest).expect("the manifest");
    fs::write(&manifest, format!("{text}\n")).expect("the manifest");
    assert_fails(&output(&run), 77, &["the signature is over the bundle", "changed since"]);
    let listed = json(&["sign", "--list", &bundle, "--json"]);
    assert!(listed[0]["refused"].as_str().is_some_and(|reason| reason.contains("changed since")));
    fs::write(&manifest, text).expect("the manifest");
    fs::write(format!("{bundle}/card.md"), "another card").expect("a file");
    assert_fails(&output(&run), 65, &["card.md", "was changed"]);
}

#[test]
fn a_team_loads_no_other_bundle_that_nobody_signed() {
    let signer = Signer::new();
    copy(Path::new(&format!("{BUNDLE}-large")), Path::new(&signer.path("large")));
    signer.sign("better");
    let (bundle, large, keys) = (signer.path("better"), signer.path("large"), signer.path("keys"));
    let domain = TestDomain::new("reload");
    let told = ["up", &bundle, "--trust", &keys, "--domain", &domain.id, "--quiet", "--isolate"];
    let up = sortie(&told).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    let mut up = Playing(up.expect("a team"));
    wait_until("everybody is there", || {
        let told = output(&["control", "info", "--domain", &domain.id, "--json"]);
        let answer: Value = serde_json::from_slice(&told.stdout).unwrap_or_default();
        answer["processes"].as_array().is_some_and(|processes| processes.len() == 8)
    });
    let reload = ["control", "reload", &large, "--domain", &domain.id, "--json"];
    assert_fails(&output(&reload), 66, &["cannot be read"]);
    signer.sign("large");
    let reloaded = json(&reload);
    let processes = reloaded["processes"].as_array().expect("processes");
    assert!(processes.iter().all(|process| process["outcome"] == "done"), "{reloaded}");
    json(&["control", "shut-down", "--domain", &domain.id, "--json"]);
    assert_eq!(up.0.ended().code(), Some(0));
    assert_eq!(domain.leftovers(), Vec::<PathBuf>::new());
}

#[test]
fn a_plan_is_signed_beside_itself_and_served_to_who_trusts_its_signer() {
    let signer = Signer::new();
    let (plan, keys) = (signer.path("cart.plan"), signer.path("keys"));
    fs::copy(CART, &plan).expect("a copy");
    let serve = ["serve", &plan, "--trust", &keys];
    let refused = [&serve[..], &NO_DOMAIN].concat();
    assert_fails(&output(&refused), 77, &["cart.plan is not signed"]);
    signer.sign("cart.plan");
    assert_eq!(fs::read(format!("{plan}.sig")).expect("signatures").len(), 104);
    let domain = TestDomain::new("signed-plan");
    let served = [&serve[..], &["--domain", &domain.id, "--json"]].concat();
    let mut server = sortie(&served).stdout(Stdio::null()).spawn().expect("a server");
    wait_until("it serves", || {
        output(&["control", "shut-down", "--domain", &domain.id]).status.success()
    });
    assert!(server.ended().success());
    // Of the test key that stands in the documentation of the core, which nobody here trusts.
    fs::copy(format!("{CART}.sig"), format!("{plan}.sig")).expect("a copy");
    assert_fails(&output(&refused), 77, &["with no key of"]);
    assert_eq!(json(&["sign", "--list", &plan, "--json"])[0]["refused"], Value::Null);
    signer.sign("cart.plan");
    fs::write(&plan, [&fs::read(CART).expect("a plan")[..], &[0]].concat()).expect("a plan");
    assert_fails(&output(&refused), 77, &["cart.plan.sig", "forged, or changed since"]);
    let onnx = "tests/golden/onnx-unplanned/scatters.onnx";
    let served = [&["serve", onnx, "--trust", &keys][..], &NO_DOMAIN].concat();
    assert_fails(&output(&served), 2, &["are of bundles and of plans"]);
    assert_fails(&output(&["verify", onnx, "--trust", &keys]), 2, &["are of bundles and of plans"]);
    assert_fails(&output(&["sign", &signer.path("keys/me"), onnx]), 2, &["compile the file"]);
}

#[test]
fn a_secret_key_is_neither_shown_nor_replaced_nor_read_by_others() {
    let signer = Signer::new();
    let (pair, secret) = (signer.path("keys/me"), signer.path("keys/me.key"));
    let text = fs::read_to_string(&secret).expect("a key");
    let digits = text.lines().find_map(|line| line.strip_prefix("secret = ")).expect("digits");
    let digits = digits.trim_matches('"');
    for arguments in [vec!["sign", "--new", &pair], vec!["sign", &pair, "no/bundle"]] {
        let told = output(&arguments);
        assert!(!told.status.success() && !stderr(&told).contains(digits), "{}", stderr(&told));
    }
    assert_fails(&output(&["sign", "--new", &pair]), 2, &["is there already"]);
    assert_eq!(fs::read_to_string(&secret).expect("a key"), text);
    let made = output(&["sign", "--new", &signer.path("keys/two"), "--json"]);
    let made: Value = serde_json::from_slice(&made.stdout).expect("JSON");
    assert!(made["file"].as_str().is_some_and(|file| file.ends_with("keys/two.pub")), "{made}");
    fs::set_permissions(&secret, fs::Permissions::from_mode(0o644)).expect("permissions");
    let bundle = signer.path("better");
    assert_fails(&output(&["sign", &pair, &bundle]), 77, &["can be read by others", "chmod 600"]);
    assert_fails(&output(&["sign", &signer.path("keys/no"), &bundle]), 66, &["no.key is missing"]);
}
