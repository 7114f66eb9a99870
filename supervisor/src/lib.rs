//! The PC at the other end of a tesaki board's serial line: robot folders, and the client side of the protocol.

mod board;
pub mod fault_injector;
#[cfg(unix)]
pub mod hub;
mod link;
#[cfg(unix)]
pub mod port;
pub mod robot;

pub use board::{Board, BoardError};
pub use link::{ByteLink, LinkBoard};
