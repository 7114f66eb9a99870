//! Tests of a node through its requests, sensors and outputs.

mod arm;
mod arm_closed_loop;
mod arm_stops;
mod enabling;
mod exhaustive;
mod export;
mod faults;
mod fingertips;
mod force_sensors;
mod grasp;
mod lease;
mod limits;
mod model;
mod pressing;
mod releasing;
mod replay;
mod rig;
mod setpoints;
mod stops;
mod stream_torques;
