//! Rigid-body dynamics of serial chains.
//!
//! Inside, every joint frame is turned so that its axis is z: a joint's rotation then costs four multiplications a
//! vector. The links' mass data are turned along; nothing outside sees it.

mod chain;
mod newton_euler;

pub use chain::Chain;
