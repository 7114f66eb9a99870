//! The PC at the other end of a tesaki board's serial line: robot folders, the client side of the protocol,
//! motions for it to send, and the ways to the board: ports, a hub for several programs, and a bad line for tests.

pub mod arm;
mod board;
pub mod fault_injector;
mod file;
pub mod finding;
pub mod grasp;
pub mod hand;
#[cfg(unix)]
pub mod hub;
pub mod identify;
mod link;
pub mod mcap;
#[cfg(feature = "cli")]
pub mod monitor;
#[cfg(unix)]
pub mod port;
pub mod robot;
pub mod trajectory;
pub mod urdf;

pub use board::{Board, BoardError, Exported};
pub use file::FileError;
pub use link::{ByteLink, LinkBoard};
