//! Parts of motor-driver boards that do not depend on a microcontroller, so that they can be tested on a PC.
//!
//! | module | what |
//! |---|---|
//! | [`handover`] | values from an RTIC task to one that preempts it, without a critical section |
//! | [`exchange`] | messages between the control task and the current loops, as words of a handover |
//! | [`joints`] | connects the model's joints to brushed motors: units, velocities, refusals |
//! | [`motors`] | brushed motors on power stages: wake, current loops, trip, command timeout |
//! | [`current_sign`] | the sign of a current of which only the magnitude is measured |
//! | [`ads131m06`] | converter for six strain gauges |
//! | [`gauges`] | six strain gauges behind that converter, as the wrench of a force sensor |
//! | [`drv8874`] | constants of the power stage DRV8874 |
//! | [`drv8301`] | gate driver and shunt amplifiers DRV8301 |
//! | [`gates`] | gate drivers behind one enable line: wake, set-up, checks, sleep |
//! | [`offset`] | the offset of a measured current |
//! | [`counter`] | extension of 16-bit counters to 32 bits |
//! | [`back_emf`] | detection of dead encoders by the back-EMF of their motors |

#![cfg_attr(not(test), no_std)]

pub mod ads131m06;
pub mod back_emf;
pub mod counter;
pub mod current_sign;
pub mod drv8301;
pub mod drv8874;
pub mod exchange;
pub mod gates;
pub mod gauges;
pub mod handover;
pub mod joints;
pub mod motors;
pub mod offset;
