use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Address of a board.
///
/// ```
/// # use tesaki_supervisor::port::Address;
/// let address: Address = "unix:///run/hand.sock".parse()?;
/// assert_eq!(address, Address::Unix("/run/hand.sock".into()));
/// assert_eq!(address.to_string(), "unix:///run/hand.sock");
/// # Ok::<(), tesaki_supervisor::port::AddressError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Address {
    /// `auto`: the only available board.
    #[default]
    Auto,
    /// `/dev/ttyUSB0`: a serial port or a pseudo-terminal.
    Path(PathBuf),
    /// `unix:///run/x.sock`: a Unix socket.
    Unix(PathBuf),
    /// `tcp://host:port`; an IPv6 host is written in brackets.
    Tcp(String),
}

/// Why a text is not an [`Address`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    /// The text is empty.
    #[error("no port given: use one such as {EXAMPLES}")]
    Empty,
    /// Neither a path nor a known scheme.
    #[error("\"{0}\" is not a port{hint}: use one such as {EXAMPLES}", hint = guess(.0))]
    Unknown(String),
    /// Where a socket is needed, something else.
    #[error("\"{text}\" is not a socket{hint}: use one such as unix:///run/hand.sock or tcp://localhost:7400", text = .0, hint = guess_socket(.0))]
    NotSocket(String),
    /// `unix:` without a path.
    #[error("\"{0}\" names no socket file: write it like unix:///run/hand.sock")]
    NoSocket(String),
    /// `tcp:` without a usable host and port.
    #[error(
        "\"{0}\" is not a host and a port from 0 to 65535: write it like tcp://localhost:7400 or tcp://[::1]:7400"
    )]
    NotHostAndPort(String),
}

const EXAMPLES: &str = "auto, /dev/ttyUSB0, unix:///run/hand.sock or tcp://localhost:7400";

/// Returns the probable intention as a hint.
fn guess(text: &str) -> String {
    let device = Path::new("/dev").join(text);
    if text.starts_with("tty") || device.exists() {
        format!(" (did you mean {}?)", device.display())
    } else if is_host_and_port(text) {
        format!(" (did you mean tcp://{text}?)")
    } else {
        String::new()
    }
}

/// Returns the probably intended socket as a hint.
fn guess_socket(text: &str) -> String {
    let scheme = if is_host_and_port(text) { "tcp" } else { "unix" };
    if text.contains("://") { String::new() } else { format!(" (did you mean {scheme}://{text}?)") }
}

fn is_host_and_port(text: &str) -> bool {
    text.rsplit_once(':').is_some_and(|(host, port)| {
        let bracketed = host.starts_with('[') && host.ends_with(']') && host.len() > 2;
        let plain = !host.is_empty() && !host.contains([':', '/', '[', ']', ' ']);
        (bracketed || plain) && port.bytes().all(|byte| byte.is_ascii_digit()) && port.parse::<u16>().is_ok()
    })
}

fn is_com_port(text: &str) -> bool {
    text.split_at_checked(3).is_some_and(|(com, number)| {
        com.eq_ignore_ascii_case("COM") && number.parse::<u16>().is_ok_and(|number| number > 0)
    })
}

impl Address {
    /// Parses the address of a socket.
    ///
    /// # Errors
    /// When the text is not an address, or not that of a socket.
    pub fn socket(text: &str) -> Result<Self, AddressError> {
        match text.parse() {
            Ok(Self::Auto | Self::Path(_)) | Err(AddressError::Unknown(_)) => {
                Err(AddressError::NotSocket(text.trim().to_owned()))
            }
            parsed => parsed,
        }
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let text = text.trim();
        if text.is_empty() {
            return Err(AddressError::Empty);
        }
        if text.eq_ignore_ascii_case("auto") {
            return Ok(Self::Auto);
        }
        if let Some(rest) = text.strip_prefix("unix:") {
            let path = rest.strip_prefix("//").unwrap_or(rest);
            let is_file = !path.is_empty() && !path.ends_with('/');
            return is_file
                .then(|| Self::Unix(path.into()))
                .ok_or_else(|| AddressError::NoSocket(text.to_owned()));
        }
        if let Some(rest) = text.strip_prefix("tcp:") {
            let host = rest.strip_prefix("//").unwrap_or(rest);
            let host = host.strip_suffix('/').unwrap_or(host);
            return is_host_and_port(host)
                .then(|| Self::Tcp(host.to_owned()))
                .ok_or_else(|| AddressError::NotHostAndPort(text.to_owned()));
        }
        // A bare word is more often a mistake than a file in the current directory, which can be written
        // `./word`.
        if (text.contains(['/', '\\']) && !text.contains("://")) || is_com_port(text) {
            return Ok(Self::Path(text.into()));
        }
        Err(AddressError::Unknown(text.to_owned()))
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Path(path) => write!(f, "{}", path.display()),
            Self::Unix(path) => write!(f, "unix://{}", path.display()),
            Self::Tcp(host) => write!(f, "tcp://{host}"),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_written_alike() {
        let cases = [
            ("auto", Address::Auto),
            ("/dev/ttyUSB0", Address::Path("/dev/ttyUSB0".into())),
            ("./pty", Address::Path("./pty".into())),
            ("COM3", Address::Path("COM3".into())),
            ("unix:///run/x.sock", Address::Unix("/run/x.sock".into())),
            ("unix://x.sock", Address::Unix("x.sock".into())),
            ("tcp://localhost:7400", Address::Tcp("localhost:7400".into())),
            ("tcp://[::1]:7400", Address::Tcp("[::1]:7400".into())),
        ];
        for (text, address) in cases {
            assert_eq!(text.parse(), Ok(address.clone()), "{text}");
            assert_eq!(address.to_string(), text);
        }
        assert_eq!("unix:/run/x".parse(), Ok(Address::Unix("/run/x".into())));
        assert_eq!("tcp:host:1/".parse(), Ok(Address::Tcp("host:1".into())));
    }

    #[test]
    fn slips_are_named() {
        let error = |text: &str| text.parse::<Address>().unwrap_err();
        assert_eq!(error(" "), AddressError::Empty);
        assert!(error("ttyUSB0").to_string().contains("did you mean /dev/ttyUSB0?"));
        assert!(error("host:7400").to_string().contains("did you mean tcp://host:7400?"));
        for unknown in ["http://host:1", "COM", "COM0", "board"] {
            assert!(matches!(error(unknown), AddressError::Unknown(_)), "{unknown}");
        }
        for (text, guess) in
            [("foo", "unix://foo"), ("./foo", "unix://./foo"), ("localhost:1", "tcp://localhost:1")]
        {
            let error = Address::socket(text).unwrap_err().to_string();
            assert!(error.contains(&format!("did you mean {guess}?")), "{error}");
        }
        assert_eq!(Address::socket("unix:"), Err(AddressError::NoSocket("unix:".into())));
        assert_eq!(Address::socket("tcp://[::1]:7400"), Ok(Address::Tcp("[::1]:7400".into())));
        for socket in ["unix:", "unix://", "unix:///run/"] {
            assert!(matches!(error(socket), AddressError::NoSocket(_)), "{socket}");
        }
        for host in
            ["tcp://", "tcp://host", "tcp://:1", "tcp://host:65536", "tcp://host:+1", "tcp://::1:7400"]
        {
            assert!(matches!(error(host), AddressError::NotHostAndPort(_)), "{host}");
        }
    }
}
