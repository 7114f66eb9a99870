//! `host-sim serve`, started as a reader would.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// Variants of the control core of a served board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    Native,
    /// The image named by `TESAKI_ELF`, in QEMU.
    Qemu,
}

/// A served board; it stops when this is dropped.
pub struct Served {
    program: Child,
    /// The address at which it listens.
    pub port: String,
    /// The commands that it printed, without `tesaki`.
    told: Vec<String>,
}

impl Served {
    /// Starts it with these arguments from the page, in `folder`.
    pub fn start(kind: Kind, arguments: &[&str], folder: &Path) -> Self {
        let mut command = tesaki_tests::program("host-sim");
        command.args(arguments).current_dir(folder).env("XDG_RUNTIME_DIR", folder);
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        if kind == Kind::Qemu {
            let elf = std::env::var_os("TESAKI_ELF").expect("TESAKI_ELF is not set: run `cargo xtask test`");
            command.args(["--controller", "qemu"]).env("TESAKI_ELF", elf);
        }
        let mut program = command.spawn().unwrap();
        let output = BufReader::new(program.stdout.take().unwrap());
        let (mut port, mut told) = (None, Vec::new());
        for line in output.lines().map(Result::unwrap) {
            if let Some(socket) = line.trim_start().strip_prefix("socket ") {
                port = socket.split_whitespace().next().map(str::to_owned);
            }
            told.extend(line.strip_prefix("  tesaki ").map(str::to_owned));
            if line.starts_with("Ctrl-C stops") {
                break;
            }
        }
        let port = port.unwrap_or_else(|| panic!("{arguments:?} told no socket"));
        Self { program, port, told }
    }

    /// Returns the words after `name` in the printed command that begins with it.
    pub fn told(&self, name: &str) -> Option<Vec<String>> {
        let words = self.told.iter().find_map(|command| command.strip_prefix(name)?.strip_prefix(' '));
        words.map(|words| words.split(' ').map(str::to_owned).collect())
    }

    /// Returns the printed commands between the diagnosis and the example.
    pub fn set_up(&self) -> impl Iterator<Item = &str> {
        let names = ["model push", "home", "tare"];
        let commands = self.told.iter().filter(move |told| names.iter().any(|name| told.starts_with(name)));
        commands.map(String::as_str)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        interrupt(&self.program, Signal::SIGINT);
        let _ = self.program.wait();
    }
}

pub fn interrupt(child: &Child, signal: Signal) {
    let _ = kill(Pid::from_raw(i32::try_from(child.id()).unwrap()), signal);
}

/// Creates a command of the program `tesaki` in `folder`, for a board at `port` on a busy machine.
pub fn tesaki(port: &str, folder: &Path) -> Command {
    let mut command = tesaki_tests::program("tesaki");
    command.current_dir(folder).env("XDG_RUNTIME_DIR", folder).stdin(Stdio::null());
    command.env("TESAKI_PORT", port).env("TESAKI_TIMEOUT", "10");
    command
}
