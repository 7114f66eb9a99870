//! A hand with one board per finger: it behaves like the same hand on one board, and all boards stop if one
//! does.
#![allow(clippy::unwrap_used, clippy::cast_possible_truncation, clippy::disallowed_methods, reason = "tests")]

mod image;
mod lifting;
mod links;
mod refusals;
mod rig;
mod slipping;
mod stopping;
