//! The node from outside: what is refused, what faults, and what the outputs do then.

mod arm;
mod arm_loop;
mod arming;
mod bench;
mod export;
mod faults;
mod fingertips;
mod force_sensors;
mod grasp;
mod guide;
mod lease;
mod limits;
mod model;
mod replay;
mod set_points;
