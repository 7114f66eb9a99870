use std::fs::{self, File, TryLockError};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;

use nix::errno::Errno;
use nix::fcntl::OFlag;
use serial2::{IntoSettings as _, SerialPort};

use super::open::explain;
use super::{Address, PortError};

/// The serial line's speed in baud, with 8 data bits, no parity and 1 stop bit.
pub const BAUD_RATE: u32 = 921_600;

/// Opens, locks and configures a serial port.
pub(super) fn open_serial(path: &Path) -> Result<File, PortError> {
    let explain = |error| explain(Address::Path(path.to_owned()), error);
    let not_serial = |hint: &str| PortError::NotSerial { path: path.to_owned(), hint: hint.to_owned() };
    // Asked first, as opening a named pipe would wait and opening a tape would wind it.
    let kind = fs::metadata(path).map_err(explain)?.file_type();
    if kind.is_socket() {
        return Err(not_serial(&format!("it is a socket, write unix://{}", path.display())));
    }
    if !kind.is_char_device() {
        return Err(not_serial("it is not a device; serial ports look like /dev/ttyUSB0 or /dev/ttyACM0"));
    }
    let file = fs::OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags((OFlag::O_NONBLOCK | OFlag::O_NOCTTY).bits())
        .open(path)
        .map_err(explain)?;
    // Two programs that read one port would each get some of the bytes.
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return Err(busy(path)),
        Err(TryLockError::Error(error)) => return Err(explain(error)),
    }
    let mut port = SerialPort::from(OwnedFd::from(file));
    configure(&mut port).map_err(|error| match error.raw_os_error().map(Errno::from_raw) {
        Some(Errno::ENOTTY) => {
            not_serial("it is a device of another kind; serial ports look like /dev/ttyUSB0")
        }
        // Linux's answer for a /dev/ttyS* without hardware.
        Some(Errno::EIO) => not_serial("there is no hardware behind it"),
        // `serial2` read the settings back and found others: a plain UART often ends at 115200 baud.
        None => explain(io::Error::new(
            io::ErrorKind::Unsupported,
            format!("it cannot do {BAUD_RATE} baud with 8 data bits and no parity: use an adapter that can"),
        )),
        _ => explain(error),
    })?;
    Ok(OwnedFd::from(port).into())
}

fn configure(port: &mut SerialPort) -> io::Result<()> {
    let mut settings = port.get_configuration()?;
    BAUD_RATE.apply_to_settings(&mut settings)?; // raw, 8N1, no flow control
    port.set_configuration(&settings)?;
    // What came while nobody listened is old.
    port.discard_input_buffer()
}

/// The group that may open `path`: `dialout` on most systems, `uucp` on some.
pub(super) fn group(path: &Path) -> String {
    fs::metadata(path)
        .ok()
        .filter(|file| file.gid() != 0 && file.mode() & 0o060 == 0o060)
        .and_then(|file| nix::unistd::Group::from_gid(file.gid().into()).ok()?)
        .map_or_else(|| "dialout".to_owned(), |group| group.name)
}

/// Says who has the port.
pub(super) fn busy(path: &Path) -> PortError {
    let pid = lock_holder(path);
    let program = pid.and_then(|pid| fs::read_to_string(format!("/proc/{pid}/comm")).ok());
    let program = program.map(|name| name.trim_end().to_owned());
    PortError::Busy { path: path.to_owned(), pid, program }
}

/// Who holds the lock on `path`, by the kernel's list: `1: FLOCK  ADVISORY  WRITE 14300 fe:00:5480477 0 EOF`.
fn lock_holder(path: &Path) -> Option<u32> {
    let file = fs::metadata(path).ok()?;
    let (major, minor) = (nix::sys::stat::major(file.dev()), nix::sys::stat::minor(file.dev()));
    let name = format!("{major:02x}:{minor:02x}:{}", file.ino());
    let locks = fs::read_to_string("/proc/locks").ok()?;
    let holder = locks.lines().find_map(|line| {
        let mut words = line.split_whitespace().skip(1);
        // A line with an arrow is a process that waits for the lock.
        let pid = words.next().filter(|&kind| kind == "FLOCK").and_then(|_| words.nth(2))?;
        (words.next() == Some(&name)).then_some(pid)
    });
    holder?.parse().ok()
}
