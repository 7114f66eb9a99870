//! Parts of motor-driver boards that know no microcontroller, and so run in tests on a PC.
//!
//! | module | what |
//! |---|---|
//! | [`handover`] | values from an RTIC task to one that preempts it, without a critical section |
//! | [`motors`] | brushed motors on power stages: wake, current loops, trip, dead man |
//! | [`current_sign`] | the sign of a current of which only the magnitude is measured |
//! | [`ads131m06`] | converter for six strain gauges |
//! | [`drv8874`] | numbers of the power stage DRV8874 |
//! | [`counter`] | counters of 16 bits as long ones |

#![cfg_attr(not(test), no_std)]

pub mod ads131m06;
pub mod counter;
pub mod current_sign;
pub mod drv8874;
pub mod handover;
pub mod motors;
