//! The PC at the other end of a tesaki board's serial line: robot folders, and the client side of the protocol.

mod board;
mod link;
pub mod mcap;
pub mod robot;

pub use board::{Board, BoardError};
pub use link::{ByteLink, LinkBoard};
