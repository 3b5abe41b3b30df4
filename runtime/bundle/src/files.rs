//! Files that are read within limits, and written whole or not at all; and their hashes.
//!
//! A file is written beside its place and moved there by one rename: whoever reads it sees the old or the new
//! content, even after a crash. What cannot be finished is removed again.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::OFlags;
use sha2::{Digest, Sha256};

/// The largest file of numbers that is read: networks, plans, recordings.
pub const MOST_BYTES: u64 = 256 << 20;
/// The largest file that people write: settings and descriptions.
pub const MOST_TEXT_BYTES: u64 = 16 << 20;

/// Reads a file of at most `most` bytes: a regular one, or what a pipe holds until its writers have gone.
///
/// # Errors
/// Those of the system; [`IsADirectory`](io::ErrorKind::IsADirectory); [`InvalidInput`](io::ErrorKind::InvalidInput) for
/// devices and sockets, which may never end; [`FileTooLarge`](io::ErrorKind::FileTooLarge); [`Interrupted`](io::ErrorKind::Interrupted) where a signal
/// comes while a pipe is waited for.
pub fn read_file(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let kind = fs::metadata(path)?.file_type();
    if !kind.is_file() && !kind.is_fifo() {
        let (kind, what) = match kind.is_dir() {
            true => (io::ErrorKind::IsADirectory, "a folder"),
            false => (io::ErrorKind::InvalidInput, "a device or a socket"),
        };
        return Err(io::Error::new(
            kind,
            format!("is {what}, which is not read: name a file, or a pipe"),
        ));
    }
    // Opening a pipe would wait for its writer, and no signal would end that.
    let flags = OFlags::NONBLOCK.bits().cast_signed();
    let mut file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    let mut bytes = Vec::new();
    loop {
        if kind.is_fifo() {
            poll(&mut [PollFd::new(&file, PollFlags::IN)], None)?;
        }
        let before = bytes.len();
        match Read::take(&mut file, most + 1 - before as u64).read_to_end(&mut bytes) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) => return Err(error),
            Ok(_) if bytes.len() as u64 > most => {
                let refused = format!("has more than {} MiB, which are not read", most >> 20);
                return Err(io::Error::new(io::ErrorKind::FileTooLarge, refused));
            }
            Ok(_) => return Ok(bytes),
        }
    }
}

/// Reads a text, as [`read_file`] does.
///
/// # Errors
/// The same; [`InvalidData`](io::ErrorKind::InvalidData) where it is no UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let refused = |_| io::Error::new(io::ErrorKind::InvalidData, "is no text: it is not UTF-8");
    String::from_utf8(read_file(path, most)?).map_err(refused)
}

/// Whether what was written must outlive a failure of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// The system writes it to the disk when it likes.
    Cached,
    /// It is on the disk when the call returns.
    Forced,
}

const PREFIX: &str = ".sortie-";
const SUFFIX: &str = ".draft";

/// Replaces a file as a whole, or leaves it as it is.
///
/// What is no file, such as `/dev/stdout`, is written to where it is.
pub fn replace_file(path: &Path, content: &[u8], durability: Durability) -> io::Result<()> {
    if is_stream(path) {
        return OpenOptions::new().write(true).open(path)?.write_all(content);
    }
    // A link stays a link.
    let place = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let draft = draft_beside(&place);
    let written = write_file(&draft, content, durability).and_then(|()| {
        if let Ok(old) = fs::metadata(&place) {
            fs::set_permissions(&draft, old.permissions())?;
        }
        fs::rename(&draft, &place)
    });
    if written.is_err() {
        // The first error matters.
        let _ = fs::remove_file(&draft);
        return written;
    }
    match durability {
        Durability::Cached => Ok(()),
        Durability::Forced => sync_folder(folder_of(&place)),
    }
}

/// Writes a file in its place: for folders that are moved as a whole.
pub fn write_file(path: &Path, content: &[u8], durability: Durability) -> io::Result<()> {
    write_parts(path, [content], durability)
}

/// The same of parts, one behind the other, which need not stand together in memory.
pub fn write_parts<'a>(
    path: &Path,
    parts: impl IntoIterator<Item = &'a [u8]>,
    durability: Durability,
) -> io::Result<()> {
    let mut file = File::create(path)?;
    parts.into_iter().try_for_each(|part| file.write_all(part))?;
    match durability {
        Durability::Cached => Ok(()),
        Durability::Forced => file.sync_all(),
    }
}

/// Whether a file can be written in that place; nothing is changed there.
pub fn check_writable(path: &Path) -> io::Result<()> {
    if path.exists() {
        OpenOptions::new().write(true).open(path)?;
    }
    if is_stream(path) {
        return Ok(());
    }
    let place = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    check_folder(folder_of(&place))
}

/// Whether files can be made in a folder.
pub fn check_folder(folder: &Path) -> io::Result<()> {
    let draft = draft_beside(&folder.join("file"));
    File::create(&draft)?;
    fs::remove_file(&draft)
}

/// Removes drafts that processes left in a folder when they died.
pub fn remove_drafts(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if is_draft(&entry.file_name().to_string_lossy()) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Whether a file of that name is a draft.
pub fn is_draft(name: &str) -> bool {
    name.starts_with(PREFIX) && name.ends_with(SUFFIX)
}

/// Makes renames in a folder durable.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

/// Whether a path names a device or a pipe, which cannot be replaced.
fn is_stream(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

/// The folder of a file; that of a bare name is the current one.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// A name that nobody else takes, in the same folder.
fn draft_beside(path: &Path) -> PathBuf {
    static DRAFTS: AtomicU64 = AtomicU64::new(0);
    let number = DRAFTS.fetch_add(1, Ordering::Relaxed);
    folder_of(path).join(format!("{PREFIX}{}-{number}{SUFFIX}", std::process::id()))
}

/// SHA-256 of `bytes`.
pub fn sha256(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// Bytes as lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().flatten();
        let mut names: Vec<String> =
            entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_as_a_whole_and_nothing_else_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        for durability in [Durability::Cached, Durability::Forced] {
            for content in ["a long content", "short"] {
                replace_file(&path, content.as_bytes(), durability).unwrap();
                assert_eq!(fs::read_to_string(&path).unwrap(), content);
            }
        }
        assert_eq!(names(folder.path()), ["file"]);
    }

    #[test]
    fn a_draft_that_cannot_be_moved_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        fs::create_dir(&path).unwrap();
        fs::write(path.join("inside"), "").unwrap();
        assert!(replace_file(&path, b"content", Durability::Cached).is_err());
        assert_eq!(names(folder.path()), ["taken"]);
        assert!(check_writable(&path).is_err());
        assert!(check_writable(&folder.path().join("nowhere/file")).is_err());
        assert!(check_writable(&folder.path().join("file")).is_ok());
        assert_eq!(names(folder.path()), ["taken"], "trying leaves nothing");
    }

    #[test]
    fn links_stay_links_and_streams_are_written_to() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "old").unwrap();
        symlink(&file, &link).unwrap();
        replace_file(&link, b"new", Durability::Cached).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        replace_file(Path::new("/dev/null"), b"gone", Durability::Cached).unwrap();
        assert!(check_writable(Path::new("/dev/null")).is_ok());
    }

    #[test]
    fn drafts_of_the_dead_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(draft_beside(&folder.path().join("file")), "half").unwrap();
        fs::write(folder.path().join("file"), "whole").unwrap();
        remove_drafts(folder.path());
        assert_eq!(names(folder.path()), ["file"]);
    }

    #[test]
    fn files_are_read_up_to_their_limit_and_devices_never() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let kind = |path: &Path, most| read_file(path, most).map_err(|error| error.kind());
        assert_eq!(kind(&path, 1), Err(io::ErrorKind::NotFound));
        fs::write(&path, [7, 0xFF]).unwrap();
        assert_eq!(kind(&path, 2), Ok(vec![7, 0xFF]));
        assert_eq!(kind(&path, 1), Err(io::ErrorKind::FileTooLarge));
        assert_eq!(read_text(&path, 2).unwrap_err().kind(), io::ErrorKind::InvalidData);
        assert_eq!(kind(folder.path(), 1), Err(io::ErrorKind::IsADirectory));
        for device in ["/dev/zero", "/dev/null"] {
            assert_eq!(kind(Path::new(device), 9), Err(io::ErrorKind::InvalidInput), "{device}");
        }
        // What says that it is empty is read all the same.
        assert!(read_text(Path::new("/proc/self/status"), 1 << 20).unwrap().contains("Pid:"));
    }

    #[test]
    fn pipes_are_read_until_their_writers_have_gone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &path, rustix::fs::Mode::RWXU).unwrap();
        let read = |most: u64, parts: &[&[u8]]| {
            let (path, parts) = (&path, parts);
            std::thread::scope(|scope| {
                let reader = scope.spawn(move || read_file(path, most));
                // A writer waits for its reader.
                let mut writer = OpenOptions::new().write(true).open(path).unwrap();
                // One that does not read to the end breaks the pipe.
                let _ = parts.iter().try_for_each(|part| writer.write_all(part));
                drop(writer);
                reader.join().unwrap().map_err(|error| error.kind())
            })
        };
        let large = vec![3; 300_000];
        assert_eq!(read(1 << 20, &[b"one", b" and ", b"two"]), Ok(b"one and two".to_vec()));
        assert_eq!(read(1 << 20, &[&large]), Ok(large.clone()));
        assert_eq!(read(1 << 20, &[]), Ok(Vec::new()));
        assert_eq!(read(299_999, &[&large]), Err(io::ErrorKind::FileTooLarge));
    }

    #[test]
    fn matches_the_published_vector() {
        let want = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hex(&sha256(b"abc")), want);
    }
}
