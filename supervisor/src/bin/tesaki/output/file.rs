//! Files with results that took long.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::path::Path;

use super::complain;
use crate::failure::Failure;

/// Fails unless the file can be written: to be checked before what would be lost otherwise.
pub fn require_writable(path: &Path) -> Result<(), Failure> {
    let is_new = !path.exists();
    // A pipe would be waited for.
    if fs::metadata(path).is_ok_and(|place| !place.is_file() && !place.is_dir()) {
        return Ok(());
    }
    OpenOptions::new().append(true).create(true).open(path).map_err(Failure::written(path))?;
    // A link stays one.
    if is_new && let Ok(created) = path.canonicalize() {
        let _ = fs::remove_file(created);
    }
    Ok(())
}

/// Writes the file, and tells the results with its name if that worked.
pub fn save(
    path: &Path,
    text: &str,
    tell: impl FnOnce(Option<&Path>) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let kept = replace(path, text).map_err(Failure::file(path));
    tell(kept.is_ok().then_some(path))?;
    if kept.is_err() {
        // The results are not lost: they can be copied from the terminal.
        complain(text);
    }
    kept
}

/// Where [`save`] has put the results, in words.
pub fn written_to(path: Option<&Path>) -> String {
    path.map_or_else(|| "not written to a file".to_owned(), |path| format!("written to {}", path.display()))
}

/// Writes beside the file and then puts the new one in its place: whatever happens, the old one or the new
/// one is there.
pub fn replace(path: &Path, content: impl AsRef<[u8]>) -> io::Result<()> {
    // A link stays one.
    let place = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let old = fs::metadata(&place).ok();
    let (Some(name), true) = (place.file_name(), old.as_ref().is_none_or(fs::Metadata::is_file)) else {
        return fs::write(&place, content);
    };
    let unfinished = place.with_file_name(format!(".{}.{}.tmp", name.display(), std::process::id()));
    // On the disk before it has the name: after a loss of power the file must not be an empty one.
    let written = File::create(&unfinished)
        .and_then(|mut file| file.write_all(content.as_ref()).and_then(|()| file.sync_all()));
    match written {
        // A file that may be written, in a folder that may not.
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => return fs::write(&place, content),
        written => written
            .and_then(|()| old.map_or(Ok(()), |old| fs::set_permissions(&unfinished, old.permissions())))
            .and_then(|()| fs::rename(&unfinished, &place)),
    }
    .inspect_err(|_| {
        let _ = fs::remove_file(&unfinished);
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_as_a_whole_and_keeps_its_link_and_its_permissions() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "old").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        symlink(&file, &link).unwrap();
        let reader = File::open(&file).unwrap();
        require_writable(&link).unwrap();
        let mut told = false;
        save(&link, "new", |path| {
            told = path == Some(&*link);
            Ok(())
        })
        .unwrap();
        assert!(told);
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o640);
        // Who reads meanwhile has the old one, whole.
        assert_eq!(io::read_to_string(reader).unwrap(), "old");
        assert_eq!(names(folder.path()), ["file", "link"]);
    }

    #[test]
    fn results_are_told_where_they_cannot_be_saved() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        require_writable(&file).unwrap();
        assert!(names(folder.path()).is_empty(), "nothing is left of the check");
        let lost = folder.path().join("none").join("file");
        require_writable(&lost).unwrap_err();
        let mut told = false;
        save(&lost, "new", |path| {
            told = path.is_none();
            Ok(())
        })
        .unwrap_err();
        assert!(told);
    }
}
