//! The PC side of a tesaki board: [`Board`] and its requests, serial ports, a hub that shares a board between
//! programs, a fault injector for the link, a hand of several boards, identification of joints, and
//! calibration of an operator's hand and of a camera in the robot's hand.

pub mod angles;
pub mod arrival;
mod board;
pub mod fault_injector;
pub mod faults;
pub mod gravity;
pub mod hand;
pub mod hand_eye;
#[cfg(unix)]
pub mod hub;
pub mod identify;
mod link;
#[cfg(feature = "cli")]
pub mod monitor;
pub mod operator;
pub mod output_queue;
#[cfg(unix)]
pub mod port;
#[cfg(feature = "publication")]
pub mod publication;
#[cfg(feature = "publication")]
pub mod task_report;
pub mod timing;
pub mod trajectory;
pub mod troubleshooting;
pub mod words;

pub use board::{Board, BoardError, Exported, LEASE_EXPIRES};
pub use link::{ByteLink, LinkBoard};
