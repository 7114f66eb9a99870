//! Output of programs.
//!
//! `std::println!` panics when the reader of a pipe closes it, as `head` does. [`say!`](crate::say) then ends
//! the program quietly with exit code 0, because the reader has all that it needs.

use std::fmt::Arguments;
use std::io::{self, ErrorKind, Write};
use std::process;

/// Prints a line to standard output, as `std::println!` does.
#[macro_export]
macro_rules! say {
    () => { $crate::print(format_args!("\n")) };
    ($($text:tt)*) => { $crate::print(format_args!("{}\n", format_args!($($text)*))) };
}

/// Prints a line to standard error, as `std::eprintln!` does. A missing reader does not end the program.
#[macro_export]
macro_rules! note {
    ($($text:tt)*) => { $crate::complain(format_args!("{}\n", format_args!($($text)*))) };
}

/// Prints to standard output. Ends the program with exit code 0 if the reader has gone, or with exit code 2
/// if writing fails.
pub fn print(text: Arguments<'_>) {
    let mut output = io::stdout().lock();
    match output.write_fmt(text).and_then(|()| output.flush()) {
        Ok(()) => {}
        Err(error) if error.kind() == ErrorKind::BrokenPipe => process::exit(0),
        Err(error) => {
            complain(format_args!("standard output: {error}\n"));
            process::exit(2)
        }
    }
}

/// A word as a shell takes it for one.
#[must_use]
pub fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./+,:=@%".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// Prints to standard error, if it can be written.
pub fn complain(text: Arguments<'_>) {
    let _ = io::stderr().lock().write_fmt(text);
}
