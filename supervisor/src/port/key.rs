use std::fmt;
use std::fs::{self, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

use super::address::Address;

/// Length of a key in bytes.
const LENGTH: usize = 32;
/// Hexadecimal digits of a key in its file.
const DIGITS: usize = 2 * LENGTH;

/// The secret that is shared by both ends of an encrypted TCP connection.
///
/// Its file holds it as 64 hexadecimal digits, so that it can be copied as text, and must be readable by its
/// owner only.
#[derive(Clone)]
pub struct Key(pub(super) [u8; LENGTH]);

/// Does not show the secret.
impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key")
    }
}

impl Key {
    /// Writes a new random key to a new file.
    ///
    /// # Errors
    /// When the file exists, or cannot be written.
    pub fn create(path: &Path) -> io::Result<()> {
        let mut key = [0; LENGTH];
        getrandom::fill(&mut key).map_err(io::Error::other)?;
        let digits: String = key.iter().map(|byte| format!("{byte:02x}")).collect();
        let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
        let mut file = file.map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => {
                io::Error::new(error.kind(), "exists already, and may be in use: choose another name")
            }
            _ => error,
        })?;
        // A part of a key would be in the way of the next one.
        writeln!(file, "{digits}").and_then(|()| file.sync_all()).inspect_err(|_| {
            let _ = fs::remove_file(path);
        })
    }

    /// Reads the key, if there is a file, and if one of these addresses may be of TCP: only these are
    /// encrypted.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn for_addresses(path: Option<&Path>, addresses: &[&Address]) -> io::Result<Option<Self>> {
        let may_be_tcp = |address: &&Address| matches!(address, Address::Tcp(_) | Address::Auto);
        path.filter(|_| addresses.iter().any(may_be_tcp)).map(Self::read).transpose()
    }

    /// Reads a key.
    ///
    /// # Errors
    /// When the file cannot be read, can be read by other users, or does not hold a key.
    pub fn read(path: &Path) -> io::Result<Self> {
        let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidData, what);
        let found = fs::metadata(path).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => io::Error::new(
                error.kind(),
                "there is no such key file: make one with `tesaki key FILE`, or copy that of the other end",
            ),
            _ => error,
        })?;
        if !found.is_file() {
            return Err(invalid("is not a file: name a key file as `tesaki key FILE` writes it".to_owned()));
        }
        let mode = found.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(io::Error::new(
                io::ErrorKind::PermissionDenied,
                format!(
                    "other users have access to this key file (mode {mode:03o}): run `chmod 600 {}`. If one \
                     of them may have read it, make a new key",
                    path.display()
                ),
            ));
        }
        let mut text = Vec::new();
        // One byte more than a key with its line end, to detect files that are too long.
        fs::File::open(path)?.take(DIGITS as u64 + 3).read_to_end(&mut text)?;
        let digits = text.trim_ascii();
        let amount = match digits.len() {
            0 => "is empty",
            DIGITS => "has another character",
            1..DIGITS => "is too short",
            _ => "is too long",
        };
        decode(digits).map(Self).ok_or_else(|| {
            invalid(format!(
                "{amount}: a key file holds {DIGITS} hexadecimal digits. Copy it again from the other end, \
                 or make a new one with `tesaki key FILE` and copy it there"
            ))
        })
    }
}

/// Decodes hexadecimal digits.
fn decode(digits: &[u8]) -> Option<[u8; LENGTH]> {
    let value = |digit: u8| char::from(digit).to_digit(16);
    let (pairs, []) = digits.as_chunks::<2>() else { return None };
    let bytes = pairs.iter().map(|&[high, low]| u8::try_from(16 * value(high)? + value(low)?).ok());
    bytes.collect::<Option<Vec<u8>>>()?.try_into().ok()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::port::tests::folder;

    #[test]
    fn a_new_key_is_random_and_its_owners_alone() {
        let folder = folder("key-new");
        fs::create_dir_all(&folder).unwrap();
        let [one, two] = ["one", "two"].map(|name| folder.join(name));
        Key::create(&one).unwrap();
        Key::create(&two).unwrap();
        assert_eq!(fs::metadata(&one).unwrap().permissions().mode() & 0o777, 0o600);
        let key = Key::read(&one).unwrap();
        assert_eq!(key.0, Key::read(&one).unwrap().0);
        assert_ne!(key.0, Key::read(&two).unwrap().0);
        assert_eq!(format!("{key:?}"), "Key");
        let before = fs::read(&one).unwrap();
        let error = Key::create(&one).unwrap_err().to_string();
        assert!(error.contains("exists already"), "{error}");
        assert_eq!(fs::read(&one).unwrap(), before);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_is_not_a_key_is_refused_with_the_reason() {
        let folder = folder("key-bad");
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("key");
        let refused = |path: &Path, words: &str| {
            let error = Key::read(path).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        };
        refused(&path, "tesaki key FILE");
        refused(&folder, "is not a file");
        Key::create(&path).unwrap();
        let good = fs::read_to_string(&path).unwrap();
        let digits = good.trim();
        let upper = digits.to_uppercase();
        fs::write(&path, format!("{upper}\r\n")).unwrap();
        Key::read(&path).unwrap();
        for (text, words) in [
            ("", "is empty"),
            ("\n", "is empty"),
            (&digits[1..], "is too short"),
            (&format!("{digits}0"), "is too long"),
            (&digits.repeat(1000), "is too long"),
            (&digits.replace(&digits[..1], "x"), "another character"),
        ] {
            fs::write(&path, text).unwrap();
            refused(&path, words);
        }
        fs::write(&path, [0xff; DIGITS]).unwrap();
        refused(&path, "another character");
        fs::write(&path, good).unwrap();
        for mode in [0o640, 0o604, 0o620] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            refused(&path, "chmod 600");
        }
        fs::remove_dir_all(folder).unwrap();
    }
}
