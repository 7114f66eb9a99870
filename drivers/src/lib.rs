//! Parts of motor-driver boards that know no microcontroller, and so run in tests on a PC.
//!
//! | module | what |
//! |---|---|
//! | [`handover`] | values from an RTIC task to one that preempts it, without a critical section |
//! | [`exchange`] | what the control task and the current loops tell each other, as words of it |
//! | [`joints`] | between the model's joints and brushed motors: units, velocities, refusals |
//! | [`motors`] | brushed motors on power stages: wake, current loops, trip, dead man |
//! | [`current_sign`] | the sign of a current of which only the magnitude is measured |
//! | [`ads131m06`] | converter for six strain gauges |
//! | [`gauges`] | six strain gauges behind it, as the wrench of a force sensor |
//! | [`drv8874`] | numbers of the power stage DRV8874 |
//! | [`drv8301`] | gate driver and shunt amplifiers DRV8301 |
//! | [`gates`] | gate drivers behind one enable line: when they wake, sleep and are asked |
//! | [`offset`] | the offset of a measured current |
//! | [`counter`] | counters of 16 bits as long ones |
//! | [`back_emf`] | dead encoders, by the back-EMF of their motors |

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
