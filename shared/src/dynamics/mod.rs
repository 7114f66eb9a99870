//! Rigid-body dynamics of serial chains.

mod newton_euler;
