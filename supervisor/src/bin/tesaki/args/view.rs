//! Arguments of `view`.

use std::net::{SocketAddr, ToSocketAddrs as _};
use std::path::PathBuf;

use clap::Args;

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

fn address(text: &str) -> Result<SocketAddr, String> {
    let mut found = text
        .to_socket_addrs()
        .map_err(|error| format!("{error}; expected HOST:PORT, such as localhost:7480"))?;
    found.next().ok_or_else(|| "it has no address".to_owned())
}
