//! Fault injection for a link: loses, flips, repeats and delays bytes, reproducibly for a seed.
//!
//! [`LinkFaults`] says how bad, [`Damage`] does it to bytes alone, and [`FaultyLink`] does it to both
//! directions of a [`ByteLink`](crate::ByteLink), and delays them too. A frame here is anything that ends
//! with a zero byte.

mod damage;
mod faults;
mod link;

pub use damage::{Damage, Injected};
pub use faults::{FaultsError, LinkFaults, Pause};
pub use link::FaultyLink;
