//! Errors as the exceptions of `sortie/_errors.py`, in the words of the command line.

use std::error::Error;
use std::io::ErrorKind;
use std::path::Path;

use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use sortie_core::DecideError;

pub(crate) mod exceptions {
    use pyo3::import_exception;

    import_exception!(sortie._errors, BundleError);
    import_exception!(sortie._errors, CompileError);
    import_exception!(sortie._errors, DecideError);
    import_exception!(sortie._errors, PlanError);
    import_exception!(sortie._errors, ServeError);
}

/// An error and what caused it, on one line.
pub(crate) fn words(error: &dyn Error) -> String {
    let mut words = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let said = cause.to_string();
        // Transparent errors repeat their source.
        if !words.ends_with(&said) {
            words = format!("{words}: {said}");
        }
        source = cause.source();
    }
    words.replace('\n', " ").trim_end().to_owned()
}

/// What was being worked on, before the words.
pub(crate) fn within(name: Option<&Path>, words: String) -> String {
    name.map_or(words.clone(), |name| format!("{}: {words}", name.display()))
}

/// What the system or a reader refused, as the `OSError` that Python would raise.
pub(crate) fn of_file(path: &Path, error: &std::io::Error) -> PyErr {
    // Readers' own refusals have no number; by EISDIR Python makes an `IsADirectoryError`.
    const EISDIR: i32 = 21;
    const EINVAL: i32 = 22;
    let of_kind = match error.kind() {
        ErrorKind::IsADirectory => EISDIR,
        _ => EINVAL,
    };
    let number = error.raw_os_error().unwrap_or(of_kind);
    let words = error.to_string();
    let words = words.split(" (os error").next().unwrap_or_default().to_owned();
    PyOSError::new_err((number, words, path.display().to_string()))
}

/// Why nothing could be decided.
pub(crate) fn of_decision(error: DecideError) -> PyErr {
    exceptions::DecideError::new_err(error.to_string())
}

/// Why a served policy cannot be asked.
pub(crate) fn of_service(error: sortie_ipc::Error) -> PyErr {
    const USAGE: u8 = 2;
    match error.exit_code() {
        USAGE => PyValueError::new_err(words(&error)),
        code => exceptions::ServeError::new_err((words(&error), code)),
    }
}
