//! The simulated three-finger hand: against MuJoCo, by hand numbers, and what it says about bad input.

mod errors;
mod friction;
mod hand;
mod motion;
mod sensors;
