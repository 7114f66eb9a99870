"""The ROS 2 types of the tests, from their .msg, .srv and .action files, with the names that DDS has for them."""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float64, int8, int32, int64, sequence, uint8, uint16, uint32, uint64


def ros(package, kind="msg"):
    """Makes a class the IDL type `package::kind::dds_::Name_`."""

    def decorate(cls):
        namespace = {
            "__annotations__": cls.__annotations__,
            "__module__": cls.__module__,
            "__idl_typename__": f"{package}.{kind}.dds_.{cls.__name__}_",
        }
        return final(dataclass(type(IdlStruct)(cls.__name__, (IdlStruct,), namespace)))

    return decorate


@ros("builtin_interfaces")
class Time:
    sec: int32
    nanosec: uint32


@ros("builtin_interfaces")
class Duration:
    sec: int32
    nanosec: uint32


@ros("std_msgs")
class Header:
    stamp: Time
    frame_id: str


@ros("std_msgs")
class String:
    data: str


@ros("sensor_msgs")
class JointState:
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@ros("geometry_msgs")
class Vector3:
    x: float64
    y: float64
    z: float64


@ros("geometry_msgs")
class Quaternion:
    x: float64
    y: float64
    z: float64
    w: float64


@ros("geometry_msgs")
class Transform:
    translation: Vector3
    rotation: Quaternion


@ros("geometry_msgs")
class TransformStamped:
    header: Header
    child_frame_id: str
    transform: Transform


@ros("tf2_msgs")
class TFMessage:
    transforms: sequence[TransformStamped]


@ros("geometry_msgs")
class Wrench:
    force: Vector3
    torque: Vector3


@ros("geometry_msgs")
class WrenchStamped:
    header: Header
    wrench: Wrench


@ros("diagnostic_msgs")
class KeyValue:
    key: str
    value: str


@ros("diagnostic_msgs")
class DiagnosticStatus:
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@ros("diagnostic_msgs")
class DiagnosticArray:
    header: Header
    status: sequence[DiagnosticStatus]


@ros("rcl_interfaces")
class Log:
    stamp: Time
    level: uint8
    name: str
    msg: str
    file: str
    function: str
    line: uint32


# Requests and replies begin with the header that rmw_cyclonedds_cpp puts in front of them.


@ros("std_srvs", "srv")
class Trigger_Request:
    guid: uint64
    seq: int64
    structure_needs_at_least_one_member: uint8


@ros("std_srvs", "srv")
class Trigger_Response:
    guid: uint64
    seq: int64
    success: bool
    message: str


@ros("unique_identifier_msgs")
class UUID:
    uuid: array[uint8, 16]


@ros("action_msgs")
class GoalInfo:
    goal_id: UUID
    stamp: Time


@ros("action_msgs")
class GoalStatus:
    goal_info: GoalInfo
    status: int8


@ros("action_msgs")
class GoalStatusArray:
    status_list: sequence[GoalStatus]


@ros("action_msgs", "srv")
class CancelGoal_Request:
    guid: uint64
    seq: int64
    goal_info: GoalInfo


@ros("action_msgs", "srv")
class CancelGoal_Response:
    guid: uint64
    seq: int64
    return_code: int8
    goals_canceling: sequence[GoalInfo]


@ros("trajectory_msgs")
class JointTrajectoryPoint:
    positions: sequence[float64]
    velocities: sequence[float64]
    accelerations: sequence[float64]
    effort: sequence[float64]
    time_from_start: Duration


@ros("trajectory_msgs")
class JointTrajectory:
    header: Header
    joint_names: sequence[str]
    points: sequence[JointTrajectoryPoint]


@ros("geometry_msgs")
class Twist:
    linear: Vector3
    angular: Vector3


@ros("trajectory_msgs")
class MultiDOFJointTrajectoryPoint:
    transforms: sequence[Transform]
    velocities: sequence[Twist]
    accelerations: sequence[Twist]
    time_from_start: Duration


@ros("trajectory_msgs")
class MultiDOFJointTrajectory:
    header: Header
    joint_names: sequence[str]
    points: sequence[MultiDOFJointTrajectoryPoint]


@ros("control_msgs")
class JointTolerance:
    name: str
    position: float64
    velocity: float64
    acceleration: float64


@ros("control_msgs")
class JointComponentTolerance:
    joint_name: str
    component: uint16
    position: float64
    velocity: float64
    acceleration: float64


@ros("control_msgs", "action")
class FollowJointTrajectory_Goal:
    trajectory: JointTrajectory
    multi_dof_trajectory: MultiDOFJointTrajectory
    path_tolerance: sequence[JointTolerance]
    component_path_tolerance: sequence[JointComponentTolerance]
    goal_tolerance: sequence[JointTolerance]
    component_goal_tolerance: sequence[JointComponentTolerance]
    goal_time_tolerance: Duration


@ros("control_msgs", "action")
class FollowJointTrajectory_Result:
    error_code: int32
    error_string: str


@ros("control_msgs", "action")
class FollowJointTrajectory_Feedback:
    header: Header
    joint_names: sequence[str]
    desired: JointTrajectoryPoint
    actual: JointTrajectoryPoint
    error: JointTrajectoryPoint
    multi_dof_joint_names: sequence[str]
    multi_dof_desired: MultiDOFJointTrajectoryPoint
    multi_dof_actual: MultiDOFJointTrajectoryPoint
    multi_dof_error: MultiDOFJointTrajectoryPoint


@ros("control_msgs", "action")
class FollowJointTrajectory_FeedbackMessage:
    goal_id: UUID
    feedback: FollowJointTrajectory_Feedback


@ros("control_msgs", "action")
class FollowJointTrajectory_SendGoal_Request:
    guid: uint64
    seq: int64
    goal_id: UUID
    goal: FollowJointTrajectory_Goal


@ros("control_msgs", "action")
class FollowJointTrajectory_SendGoal_Response:
    guid: uint64
    seq: int64
    accepted: bool
    stamp: Time


@ros("control_msgs", "action")
class FollowJointTrajectory_GetResult_Request:
    guid: uint64
    seq: int64
    goal_id: UUID


@ros("control_msgs", "action")
class FollowJointTrajectory_GetResult_Response:
    guid: uint64
    seq: int64
    status: int8
    result: FollowJointTrajectory_Result
