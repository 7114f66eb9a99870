//! Fault injection for a link: loses, flips, repeats and delays bytes, reproducibly for a seed.
//!
//! [`LinkFaults`] describes the faults, [`Damage`] applies them to bytes, and [`FaultyLink`] applies them to
//! both directions of a [`ByteLink`](crate::ByteLink), and also delays the bytes. A frame here is anything
//! that ends with a zero byte.

mod damage;
mod faults;
mod link;

pub use damage::{Damage, Injected};
pub use faults::{FaultsError, LinkFaults, Pause};
pub use link::FaultyLink;
