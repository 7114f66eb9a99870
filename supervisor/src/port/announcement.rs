use std::fs::{self, File, TryLockError};
use std::io::{self, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};

use super::{Address, Found};

/// A simulated board's announcement, which is published for as long as this value lives.
///
/// One file `<pid>-<name>` in `$XDG_RUNTIME_DIR/tesaki`, or else `/tmp/tesaki-<uid>`: the address in its
/// first line, a description in its second. The file is locked as long as its writer runs. Therefore a file
/// left by a crash can be recognised even if the process ID has been reused, or has no meaning in another
/// container.
#[derive(Debug)]
pub struct Announcement {
    path: PathBuf,
    // Holds the lock.
    _file: File,
}

impl Announcement {
    /// Announces the board `name` at `address`; `about` describes it to people.
    ///
    /// # Errors
    /// When the file cannot be written, or the folder is not this user's.
    pub fn new(name: &str, address: &Address, about: &str) -> io::Result<Self> {
        Self::in_folder(&folder(), name, address, about)
    }

    fn in_folder(folder: &Path, name: &str, address: &Address, about: &str) -> io::Result<Self> {
        fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        if !is_ours(folder) {
            return Err(io::Error::new(
                io::ErrorKind::PermissionDenied,
                format!(
                    "{} does not belong to this user: remove it, or set XDG_RUNTIME_DIR",
                    folder.display()
                ),
            ));
        }
        let name = name.replace(|letter: char| !letter.is_ascii_alphanumeric() && letter != '-', "_");
        let path = folder.join(format!("{}-{name}", std::process::id()));
        // Renamed only when locked and complete, so that nobody finds it unlocked and removes it as left
        // over.
        let draft = folder.join(format!(".{}-{name}", std::process::id()));
        let mut file = File::create(&draft)?;
        file.try_lock()?;
        write!(file, "{address}\n{}\n", about.replace(['\n', '\r'], " "))?;
        fs::rename(&draft, &path)?;
        Ok(Self { path, _file: file })
    }
}

impl Drop for Announcement {
    fn drop(&mut self) {
        // If it cannot be removed now, the next listing removes it.
        let _ = fs::remove_file(&self.path);
    }
}

/// Folder of the announcements. Any user can create a folder in `/tmp`; see [`is_ours`].
fn folder() -> PathBuf {
    match std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from) {
        Some(runtime) if runtime.is_dir() => runtime.join("tesaki"),
        _ => PathBuf::from(format!("/tmp/tesaki-{}", nix::unistd::geteuid())),
    }
}

/// Returns whether a path is a folder, not a link to one, to which no other user can write.
fn is_ours(folder: &Path) -> bool {
    fs::symlink_metadata(folder).is_ok_and(|found| {
        found.is_dir() && found.uid() == nix::unistd::geteuid().as_raw() && found.mode() & 0o022 == 0
    })
}

/// Returns the announced simulated boards.
pub(super) fn list() -> Vec<Found> {
    list_folder(&folder())
}

fn list_folder(folder: &Path) -> Vec<Found> {
    if !is_ours(folder) {
        return Vec::new();
    }
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<_> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    paths.iter().filter(|path| is_announcement(path)).filter_map(|path| read(path)).collect()
}

fn is_announcement(path: &Path) -> bool {
    path.file_name()
        .and_then(|name| name.to_str()?.split_once('-'))
        .is_some_and(|(pid, _)| pid.parse::<u32>().is_ok())
}

fn read(path: &Path) -> Option<Found> {
    match File::open(path).ok()?.try_lock() {
        Err(TryLockError::WouldBlock) => {}
        _ => {
            // The lock is free, so its writer has ended.
            let _ = fs::remove_file(path);
            return None;
        }
    }
    let text = fs::read_to_string(path).ok()?;
    let (address, about) = text.split_once('\n')?;
    Some(Found {
        address: address.parse().ok()?,
        description: about.trim_end().to_owned(),
        simulated: true,
        automatic: true,
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    #[test]
    fn a_board_is_listed_while_it_is_announced_and_left_overs_are_removed() {
        let parent = crate::port::tests::folder("announcements");
        let folder = parent.join("tesaki");
        let address = Address::Unix("/run/hand.sock".into());
        let board = Announcement::in_folder(&folder, "hand/3", &address, "simulated\nhand3").unwrap();
        assert_eq!(fs::metadata(&folder).unwrap().mode() & 0o777, 0o700);
        let path = folder.join(format!("{}-hand_3", std::process::id()));
        assert!(path.exists());
        let left_over = folder.join("1-crashed"); // process 1 lives, and never wrote it
        fs::write(&left_over, "auto\n\n").unwrap();
        fs::write(folder.join("notes.txt"), "not ours").unwrap();

        let description = "simulated hand3".to_owned();
        assert_eq!(list_folder(&folder), [Found { address, description, simulated: true, automatic: true }]);
        assert!(!left_over.exists());
        assert!(folder.join("notes.txt").exists());
        drop(board);
        assert!(!path.exists());
        assert_eq!(list_folder(&folder), []);
        fs::remove_dir_all(parent).unwrap();
    }

    #[test]
    fn a_folder_that_others_can_write_to_is_not_trusted() {
        let folder = crate::port::tests::folder("untrusted");
        fs::create_dir_all(&folder).unwrap();
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o777)).unwrap();
        let error = Announcement::in_folder(&folder, "x", &Address::Auto, "").unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
        assert_eq!(list_folder(&folder), []);
        fs::remove_dir_all(folder).unwrap();
    }
}
