//! A bad line on purpose: loses, flips, repeats and delays bytes, the same ones for the same seed.
//!
//! [`LinkFaults`] says how bad, [`Damage`] does it to bytes alone, and [`FaultyLink`] does it to both
//! directions of a [`ByteLink`](crate::ByteLink), and delays them too. A frame here is whatever ends with a
//! zero byte.

mod damage;
mod faults;
mod link;

pub use damage::{Damage, Injected};
pub use faults::{FaultsError, LinkFaults, Pause};
pub use link::FaultyLink;
