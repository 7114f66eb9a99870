//! A hand whose fingers have a board each: it does what the same hand on one board does, and all boards stop
//! when one does.
#![allow(clippy::unwrap_used, clippy::cast_possible_truncation, clippy::disallowed_methods, reason = "tests")]

mod image;
mod lifting;
mod links;
mod refusals;
mod rig;
mod slipping;
mod stopping;
