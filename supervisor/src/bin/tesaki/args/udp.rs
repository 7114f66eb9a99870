//! Addresses of UDP ports whose datagrams lead a robot.

use std::net::SocketAddr;

/// Reads `address` in the argument `text`, for which something like `expected` is to be given. UDP has no
/// key: only programs on this machine may lead the robot.
///
/// # Errors
/// It is no address, has port 0, or other machines reach it.
pub fn local(text: &str, address: &str, expected: &str) -> Result<SocketAddr, String> {
    let numeric = address.replacen("localhost:", "127.0.0.1:", 1);
    match numeric.parse::<SocketAddr>() {
        Ok(address) if address.port() == 0 => {
            Err(format!("{text:?}: port 0 is none: name the port that the source sends to"))
        }
        Ok(address) if address.ip().to_canonical().is_loopback() => Ok(address),
        Ok(address) => Err(format!(
            "{} is reachable from other machines, and any program that reaches the UDP port leads the robot: use \
             127.0.0.1 or [::1], and a tunnel for other machines",
            address.ip()
        )),
        Err(_) => Err(format!("{text:?}: expected {expected}")),
    }
}
