//! Arguments of `view`, and of who else listens for browsers.

use std::net::{SocketAddr, ToSocketAddrs as _};
use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use tesaki_supervisor::port::{Address, AddressError};

/// Arguments of `tesaki view`.
#[derive(Args)]
pub struct View {
    /// Address of the page, on this machine alone: HOST:PORT
    #[arg(long, default_value = "localhost:7480", value_name = "HOST:PORT", value_parser = address)]
    pub listen: SocketAddr,
    /// Robot folder of the board's model: its solids are drawn, and its grasps and impedances can be enabled
    #[arg(long, env = "TESAKI_ROBOT", value_name = "DIR")]
    pub robot: Option<PathBuf>,
}

/// Where `tesaki share` listens, and to whom.
#[derive(Clone)]
pub enum Listen {
    /// To programs that speak to the board.
    Programs(Address),
    /// To Foxglove, which only watches.
    Foxglove(SocketAddr),
}

impl FromStr for Listen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix("foxglove://") {
            Some(host) => address(host.trim_end_matches('/')).map(Self::Foxglove),
            None => text.parse().map(Self::Programs).map_err(|error: AddressError| error.to_string()),
        }
    }
}

fn address(text: &str) -> Result<SocketAddr, String> {
    let mut found = text
        .to_socket_addrs()
        .map_err(|error| format!("{error}; expected HOST:PORT, such as localhost:7480"))?;
    found.next().ok_or_else(|| "it has no address".to_owned())
}
