//! The folder for the sockets of a simulator that serves boards, and clean-up of folders left by killed
//! simulators.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tempfile::TempDir;

/// Name of the folders, before the random part.
const PREFIX: &str = "tesaki-";
/// A younger folder may be about to be locked.
const AGE: Duration = Duration::from_secs(60);

/// Creates a folder with a lock that is released whenever this process ends. Removes the folders that other
/// simulators of this user have left.
///
/// # Errors
/// The folder cannot be created.
pub fn create() -> io::Result<(TempDir, File)> {
    let parent = std::env::temp_dir();
    let created = create_in(&parent)?;
    remove_left(&parent, fs::metadata(created.0.path())?.uid(), AGE);
    Ok(created)
}

fn create_in(parent: &Path) -> io::Result<(TempDir, File)> {
    let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(parent)?;
    let lock = File::open(folder.path())?;
    // On a file system without locks, an abandoned folder is still recognised by its sockets.
    let _ = lock.try_lock();
    Ok((folder, lock))
}

/// Removes the folders that are not locked, and contain only sockets without a listener. Folders that cannot
/// be removed stay. `user` is the numeric ID of their owner.
fn remove_left(parent: &Path, user: u32, age: Duration) {
    let folders = fs::read_dir(parent).into_iter().flatten().flatten();
    for folder in folders.map(|entry| entry.path()).filter(|path| is_named_so(path)) {
        if let Some(sockets) = left(&folder, user, age) {
            let _ = sockets.iter().try_for_each(fs::remove_file).and_then(|()| fs::remove_dir(&folder));
        }
    }
}

fn is_named_so(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    // The random part as `tempfile` creates it: six letters and digits.
    name.and_then(|name| name.strip_prefix(PREFIX))
        .is_some_and(|drawn| drawn.len() == 6 && drawn.bytes().all(|byte| byte.is_ascii_alphanumeric()))
}

/// Returns the sockets of a folder that a killed simulator has left; `None` for any other folder.
fn left(folder: &Path, user: u32, age: Duration) -> Option<Vec<PathBuf>> {
    let found = fs::symlink_metadata(folder).ok()?;
    if !found.is_dir() || found.uid() != user || found.modified().ok()?.elapsed().ok()? < age {
        return None;
    }
    File::open(folder).ok()?.try_lock().ok()?;
    let mut sockets = Vec::new();
    for entry in fs::read_dir(folder).ok()? {
        let path = entry.ok()?.path();
        let is_socket = fs::symlink_metadata(&path).ok()?.file_type().is_socket();
        let is_refused = |error: &io::Error| error.kind() == io::ErrorKind::ConnectionRefused;
        if !(is_socket && UnixStream::connect(&path).is_err_and(|error| is_refused(&error))) {
            return None;
        }
        sockets.push(path);
    }
    Some(sockets)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::os::unix::net::UnixListener;

    use super::*;

    #[test]
    fn only_the_folders_of_killed_simulators_are_removed() {
        let parent = tempfile::tempdir().unwrap();
        let folder = |name: &str| {
            let path = parent.path().join(name);
            fs::create_dir(&path).unwrap();
            path
        };
        let killed = folder("tesaki-Killed");
        drop(UnixListener::bind(killed.join("board")).unwrap());
        let empty = folder("tesaki-Empty1");
        let listening = folder("tesaki-Listen");
        let _listener = UnixListener::bind(listening.join("board")).unwrap();
        let with_file = folder("tesaki-Notes1");
        fs::write(with_file.join("notes.txt"), "not ours").unwrap();
        let other = folder("tesaki-test-17");
        let (alive, _lock) = create_in(parent.path()).unwrap();
        drop(UnixListener::bind(alive.path().join("board")).unwrap());

        let all = [&killed, &empty, &listening, &with_file, &other].map(PathBuf::as_path);
        let exist = || all.map(Path::exists);
        let user = fs::metadata(alive.path()).unwrap().uid();
        remove_left(parent.path(), user, AGE);
        assert_eq!(exist(), [true; 5]);
        remove_left(parent.path(), user + 1, Duration::ZERO);
        assert_eq!(exist(), [true; 5]);
        remove_left(parent.path(), user, Duration::ZERO);
        assert_eq!(exist(), [false, false, true, true, true]);
        assert!(alive.path().join("board").exists());
    }
}
