//! `sortie sign`: keys, and signatures of bundles and plans.

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sortie_bundle::files::{MOST_BYTES, read_file};
use sortie_bundle::hex;
use sortie_core::signature::{PublicKey, Signed};
use sortie_plans::is_plan;
use sortie_sign::{
    BundleSignature, SecretKey, bundle_signature_files, key_files, plan_signatures_of, revoke,
    sign_bundle, sign_plan,
};

use crate::deployment::open_bundle;
use crate::failure::{Failure, Outcome};
use crate::output::{print_json, say};
use crate::trust::only_plans;

/// Sign a bundle or a plan, so that others can refuse what nobody signed whom they trust
///
/// A bundle's signature is over its id, which vouches for every file of it, and lies in its folder `signatures`; that of a plan is
/// over its bytes and lies beside it, as `.sig`, for boards. Several may sign. `run`, `up`, `serve` and `verify` ask for signatures
/// with `--trust`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie sign --new keys/me                         # makes keys/me.key, which is secret, and keys/me.pub
  sortie sign keys/me models/better
  sortie sign keys/me walking.plan
  sortie sign --list models/better --json
  sortie sign --revoke keys/me --reason 'laptop stolen'")]
pub(crate) struct SignArguments {
    /// The pair of keys: `keys/me` is `keys/me.key` and `keys/me.pub`
    #[arg(required_unless_present_any = ["new", "list", "revoke"], requires = "subject")]
    key: Option<PathBuf>,
    /// What is signed: a bundle's folder, or a plan
    #[arg(value_name = "BUNDLE|PLAN")]
    subject: Option<PathBuf>,
    /// Make a pair of keys; none is ever replaced
    #[arg(long, value_name = "KEY", conflicts_with_all = ["key", "list", "revoke"])]
    new: Option<PathBuf>,
    /// Tell with which keys something is signed, trusted or not
    #[arg(long, value_name = "BUNDLE|PLAN", conflicts_with_all = ["key", "revoke"])]
    list: Option<PathBuf>,
    /// Put a public key on the list of those that are not trusted any more, `revoked.toml` beside it
    #[arg(long, value_name = "KEY", requires = "reason", conflicts_with = "key")]
    revoke: Option<PathBuf>,
    /// Why, for whoever is refused
    #[arg(long, requires = "revoke")]
    reason: Option<String>,
    /// Print JSON for scripts instead of text
    #[arg(long)]
    json: bool,
}

/// What was done, for scripts.
#[derive(Serialize)]
struct Done<'a> {
    /// The file that was written: a public key, signatures, or the list of revoked keys.
    file: &'a Path,
}

/// A signature, for scripts.
#[derive(Serialize)]
struct Listed {
    key: String,
    /// Why it counts for nobody, if it does.
    refused: Option<String>,
}

pub(crate) fn run(arguments: &SignArguments) -> Outcome {
    let SignArguments { key, subject, new, list, revoke, reason, json } = arguments;
    if let Some(pair) = new {
        return create(pair, *json);
    }
    if let Some(subject) = list {
        return tell_signers(subject, *json);
    }
    if let Some((pair, reason)) = revoke.as_ref().zip(reason.as_ref()) {
        return withdraw(pair, reason, *json);
    }
    match (key, subject) {
        (Some(pair), Some(subject)) => sign(pair, subject, *json),
        // The grammar has asked for both.
        _ => Ok(()),
    }
}

fn create(pair: &Path, json: bool) -> Outcome {
    let key = SecretKey::create(pair)?;
    let [secret, public] = key_files(pair);
    let line = format!(
        "{key}: {} is secret, {} is for those who trust it",
        secret.display(),
        public.display()
    );
    tell_done(&public, &line, json);
    Ok(())
}

fn withdraw(pair: &Path, reason: &str, json: bool) -> Outcome {
    let [_, public] = key_files(pair);
    let list = revoke(&public, reason)?;
    let line = format!("{} counts no more: {}", public.display(), list.display());
    tell_done(&list, &line, json);
    Ok(())
}

fn sign(pair: &Path, subject: &Path, json: bool) -> Outcome {
    let secret = SecretKey::read(pair)?;
    let file = if subject.is_file() {
        sign_plan(&secret, subject, &read_plan(subject)?)?
    } else {
        sign_bundle(&secret, &open_bundle(subject)?)?
    };
    let line =
        format!("{} is signed by {}: {}", subject.display(), secret.public(), file.display());
    tell_done(&file, &line, json);
    Ok(())
}

fn tell_done(file: &Path, line: &str, json: bool) {
    match json {
        true => print_json(&Done { file }),
        false => say!("{line}"),
    }
}

fn tell_signers(subject: &Path, json: bool) -> Outcome {
    let listed = if subject.is_file() { plan_signers(subject)? } else { bundle_signers(subject)? };
    if json {
        print_json(&listed);
        return Ok(());
    }
    for Listed { key, refused } in &listed {
        match refused {
            None => say!("{key} has signed it"),
            Some(reason) => say!("{key} does not count: {reason}"),
        }
    }
    Ok(())
}

fn bundle_signers(folder: &Path) -> Result<Vec<Listed>, Failure> {
    let bundle = open_bundle(folder)?;
    let judged = |path: &PathBuf| {
        let (key, checked) = match BundleSignature::read(path) {
            Ok(signature) => (digits(&signature.key), signature.check(path, bundle.id())),
            Err(error) => (path.display().to_string(), Err(error)),
        };
        Listed { key, refused: checked.err().map(|error| error.to_string()) }
    };
    Ok(bundle_signature_files(folder)?.iter().map(judged).collect())
}

fn plan_signers(path: &Path) -> Result<Vec<Listed>, Failure> {
    let plan = read_plan(path)?;
    let signatures = plan_signatures_of(path)?;
    let judged = signatures.iter().map(|found| {
        let checked = Signed::Plan(&plan).check(&found.key, &found.signature);
        Listed { key: digits(&found.key), refused: checked.err().map(|error| error.to_string()) }
    });
    Ok(judged.collect())
}

fn digits(key: &PublicKey) -> String {
    hex(&key.0)
}

fn read_plan(path: &Path) -> Result<Vec<u8>, Failure> {
    let bytes = read_file(path, MOST_BYTES).map_err(|error| Failure::file(path, &error))?;
    if is_plan(&bytes) { Ok(bytes) } else { Err(only_plans(path)) }
}
