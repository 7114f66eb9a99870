//! The messages of services and actions, field by field as CDR lays them out. `tesaki-recording` has those of
//! topics.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// `builtin_interfaces/Time` and `builtin_interfaces/Duration`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Time {
    pub sec: i32,
    pub nanosec: u32,
}

impl Time {
    /// Returns the time since 1970.
    pub fn now() -> Self {
        Self::of_nanoseconds(nanoseconds_since_1970())
    }

    /// Converts nanoseconds; ROS counts seconds up to 2038.
    pub fn of_nanoseconds(nanoseconds: u64) -> Self {
        let sec = i32::try_from(nanoseconds / 1_000_000_000).unwrap_or(i32::MAX);
        let nanosec = u32::try_from(nanoseconds % 1_000_000_000).unwrap_or(0);
        Self { sec, nanosec }
    }

    /// Converts to seconds.
    pub fn seconds(self) -> f64 {
        f64::from(self.sec) + 1e-9 * f64::from(self.nanosec)
    }
}

/// Returns the time since 1970 [ns], as in the stamps of messages.
pub fn nanoseconds_since_1970() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}

/// `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    pub stamp: Time,
    pub frame_id: String,
}

/// `std_srvs/Trigger_Request`: an empty structure has a byte.
#[derive(Clone, Debug, Default, Deserialize)]
pub struct TriggerRequest {
    _structure_needs_at_least_one_member: u8,
}

/// `std_srvs/Trigger_Response`.
#[derive(Clone, Debug, Serialize)]
pub struct TriggerResponse {
    pub success: bool,
    pub message: String,
}

/// `unique_identifier_msgs/UUID`.
pub type Uuid = [u8; 16];

/// `action_msgs/GoalInfo`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalInfo {
    pub goal_id: Uuid,
    pub stamp: Time,
}

/// The values of `action_msgs/GoalStatus` that a goal passes through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i8)]
pub enum Status {
    Unknown = 0,
    Executing = 2,
    Canceling = 3,
    Succeeded = 4,
    Canceled = 5,
    Aborted = 6,
}

impl Serialize for Status {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_i8(*self as i8)
    }
}

/// `action_msgs/GoalStatus`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct GoalStatus {
    pub goal_info: GoalInfo,
    pub status: Status,
}

/// `action_msgs/GoalStatusArray`.
#[derive(Clone, Debug, Serialize)]
pub struct GoalStatusArray {
    pub status_list: Vec<GoalStatus>,
}

/// `action_msgs/CancelGoal_Request`.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct CancelGoalRequest {
    pub goal_info: GoalInfo,
}

/// `action_msgs/CancelGoal_Response`.
#[derive(Clone, Debug, Serialize)]
pub struct CancelGoalResponse {
    pub return_code: i8,
    pub goals_canceling: Vec<GoalInfo>,
}

impl CancelGoalResponse {
    pub const NONE: i8 = 0;
    pub const UNKNOWN_GOAL_ID: i8 = 2;
    pub const GOAL_TERMINATED: i8 = 3;
}

/// `trajectory_msgs/JointTrajectoryPoint`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub positions: Vec<f64>,
    pub velocities: Vec<f64>,
    pub accelerations: Vec<f64>,
    pub effort: Vec<f64>,
    pub time_from_start: Time,
}

/// `trajectory_msgs/JointTrajectory`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    pub header: Header,
    pub joint_names: Vec<String>,
    pub points: Vec<Point>,
}

/// `trajectory_msgs/MultiDOFJointTrajectoryPoint`: transforms are 7 numbers, twists 6.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDofPoint {
    pub transforms: Vec<[f64; 7]>,
    pub velocities: Vec<[f64; 6]>,
    pub accelerations: Vec<[f64; 6]>,
    pub time_from_start: Time,
}

/// `trajectory_msgs/MultiDOFJointTrajectory`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDofTrajectory {
    pub header: Header,
    pub joint_names: Vec<String>,
    pub points: Vec<MultiDofPoint>,
}

/// `control_msgs/JointTolerance`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTolerance {
    pub name: String,
    pub position: f64,
    pub velocity: f64,
    pub acceleration: f64,
}

/// `control_msgs/JointComponentTolerance`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ComponentTolerance {
    pub joint_name: String,
    pub component: u16,
    pub position: f64,
    pub velocity: f64,
    pub acceleration: f64,
}

/// `control_msgs/FollowJointTrajectory_Goal`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    pub trajectory: JointTrajectory,
    pub multi_dof_trajectory: MultiDofTrajectory,
    pub path_tolerance: Vec<JointTolerance>,
    pub component_path_tolerance: Vec<ComponentTolerance>,
    pub goal_tolerance: Vec<JointTolerance>,
    pub component_goal_tolerance: Vec<ComponentTolerance>,
    pub goal_time_tolerance: Time,
}

/// `control_msgs/FollowJointTrajectory_SendGoal_Request`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SendGoalRequest {
    pub goal_id: Uuid,
    pub goal: Goal,
}

/// `control_msgs/FollowJointTrajectory_SendGoal_Response`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SendGoalResponse {
    pub accepted: bool,
    pub stamp: Time,
}

/// `control_msgs/FollowJointTrajectory_GetResult_Request`.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct GetResultRequest {
    pub goal_id: Uuid,
}

/// The error codes of `control_msgs/FollowJointTrajectory_Result`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum ErrorCode {
    Successful = 0,
    InvalidGoal = -1,
    InvalidJoints = -2,
    OldHeaderTimestamp = -3,
    PathToleranceViolated = -4,
    GoalToleranceViolated = -5,
}

impl Serialize for ErrorCode {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_i32(*self as i32)
    }
}

/// `control_msgs/FollowJointTrajectory_GetResult_Response`.
#[derive(Clone, Debug, Serialize)]
pub struct GetResultResponse {
    pub status: Status,
    pub error_code: ErrorCode,
    pub error_string: String,
}

/// `control_msgs/FollowJointTrajectory_FeedbackMessage`, as of Humble, Jazzy and Kilted.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Feedback {
    pub goal_id: Uuid,
    pub header: Header,
    pub joint_names: Vec<String>,
    pub desired: Point,
    pub actual: Point,
    pub error: Point,
    pub multi_dof_joint_names: Vec<String>,
    pub multi_dof_desired: MultiDofPoint,
    pub multi_dof_actual: MultiDofPoint,
    pub multi_dof_error: MultiDofPoint,
}
