use std::fs;
use std::path::Path;

use serialport::SerialPortType;

use super::{Address, announcement};

/// A port at which a board may answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    /// Its address.
    pub address: Address,
    /// Description for people.
    pub description: String,
    /// Whether a simulator announced it.
    pub simulated: bool,
    /// Whether [`Address::Auto`] may choose it: USB ports and simulated boards. A built-in port may be
    /// connected to anything, and nearly every PC has one.
    pub automatic: bool,
}

/// Returns all ports at which a board may answer: serial ports, USB first, then announced simulated boards.
pub fn list() -> Vec<Found> {
    let mut found = serial_ports();
    found.sort_by_key(|found| (!found.automatic, found.address.to_string()));
    found.extend(announcement::list());
    found
}

fn serial_ports() -> Vec<Found> {
    // `serialport` panics in containers without this folder.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").is_dir() {
        return Vec::new();
    }
    // If the system cannot list its ports, opening one reports the error.
    let ports = serialport::available_ports().unwrap_or_default();
    ports.into_iter().filter_map(|port| describe(&port.port_name, &port.port_type)).collect()
}

fn describe(path: &str, port: &SerialPortType) -> Option<Found> {
    let (description, automatic) = match port {
        SerialPortType::UsbPort(usb) => {
            let name =
                [&usb.manufacturer, &usb.product].map(|part| part.as_deref().unwrap_or_default().trim());
            let name = name.join(" ").trim().to_owned();
            let name = if name.is_empty() { "USB serial port".to_owned() } else { name };
            let serial = usb.serial_number.as_ref().map(|serial| format!(", serial number {serial}"));
            let serial = serial.unwrap_or_default();
            (format!("{name} ({:04x}:{:04x}{serial})", usb.vid, usb.pid), true)
        }
        SerialPortType::BluetoothPort => ("Bluetooth serial port".to_owned(), false),
        SerialPortType::PciPort | SerialPortType::Unknown if has_uart(Path::new(path)) => {
            ("built-in serial port".to_owned(), false)
        }
        SerialPortType::PciPort | SerialPortType::Unknown => return None,
    };
    Some(Found { address: Address::Path(path.into()), description, simulated: false, automatic })
}

/// Returns whether there is hardware behind a built-in port. Linux creates a fixed number of `/dev/ttyS*`;
/// those without a UART have type 0, `PORT_UNKNOWN`. Other kinds of port have no such file and exist only
/// with their hardware.
fn has_uart(path: &Path) -> bool {
    path.file_name()
        .and_then(|name| fs::read_to_string(Path::new("/sys/class/tty").join(name).join("type")).ok())
        .is_none_or(|kind| kind.trim() != "0")
}

/// Returns the time that a USB serial adapter buffers received bytes before it passes them on [ms]: FTDI's
/// chips wait 16 ms by default, which is most of a request's round trip. `None` for adapters and systems that
/// do not report it.
pub fn latency_timer(path: &Path) -> Option<u32> {
    latency_timer_in(Path::new("/sys/bus/usb-serial/devices"), path)
}

fn latency_timer_in(devices: &Path, path: &Path) -> Option<u32> {
    // `/dev/serial/by-id/…` and udev's own names are links to the device.
    let device = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    fs::read_to_string(devices.join(device.file_name()?).join("latency_timer")).ok()?.trim().parse().ok()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn usb_ports_are_described_and_chosen_by_themselves() {
        let usb = serialport::UsbPortInfo {
            vid: 0x10c4,
            pid: 0xea60,
            serial_number: Some("0001".to_owned()),
            manufacturer: Some("Silicon Labs".to_owned()),
            product: Some("CP2102".to_owned()),
        };
        let found = describe("/dev/ttyUSB0", &SerialPortType::UsbPort(usb)).unwrap();
        assert_eq!(found.description, "Silicon Labs CP2102 (10c4:ea60, serial number 0001)");
        assert!(found.automatic && !found.simulated);
    }

    #[test]
    fn the_latency_timer_is_read_through_links() {
        let folder = crate::port::tests::folder("latency");
        fs::create_dir_all(folder.join("ttyUSB7")).unwrap();
        fs::write(folder.join("ttyUSB7/latency_timer"), "16\n").unwrap();
        assert_eq!(latency_timer_in(&folder, Path::new("/dev/ttyUSB7")), Some(16));
        std::os::unix::fs::symlink(folder.join("ttyUSB7"), folder.join("hand")).unwrap();
        assert_eq!(latency_timer_in(&folder, &folder.join("hand")), Some(16));
        assert_eq!(latency_timer_in(&folder, Path::new("/dev/ttyUSB8")), None);
        fs::remove_dir_all(folder).unwrap();
    }
}
