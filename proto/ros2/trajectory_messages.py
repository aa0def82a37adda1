"""Messages of joint trajectories: trajectory_msgs, and the action FollowJointTrajectory."""

from enum import IntEnum
from typing import ClassVar, Final

import msgspec

from zensim.proto.messages.scalar_types import Int8, Int32, UInt16
from zensim.proto.messages.standard_messages import Duration, Header, Time, Transform, Twist
from zensim.proto.ros2.action_messages import ActionKind, GoalId

TRAJECTORY_ACTION: Final = "follow_joint_trajectory"
"""Name of the action below that of a controller."""


class TrajectoryCode(IntEnum):
    """Results of a trajectory. Source: control_msgs/action/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class JointTrajectoryPoint(msgspec.Struct, frozen=True):
    """State of joints at a time of a trajectory. Source: trajectory_msgs/msg/JointTrajectoryPoint.

    Each list is empty, or has a number for each joint: [rad or m], its derivatives, [N m or N].
    """

    ros_type: ClassVar[str] = "trajectory_msgs/msg/JointTrajectoryPoint"

    positions: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()
    time_from_start: Duration = Duration()


class JointTrajectory(msgspec.Struct, frozen=True):
    """Points that joints pass. Source: trajectory_msgs/msg/JointTrajectory."""

    ros_type: ClassVar[str] = "trajectory_msgs/msg/JointTrajectory"

    header: Header = Header()
    """Header whose stamp is the start; 0 = at once."""
    joint_names: tuple[str, ...] = ()
    points: tuple[JointTrajectoryPoint, ...] = ()


class MultiDOFJointTrajectoryPoint(msgspec.Struct, frozen=True):
    """State of planar and floating joints. Source: trajectory_msgs."""

    ros_type: ClassVar[str] = "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"

    transforms: tuple[Transform, ...] = ()
    velocities: tuple[Twist, ...] = ()
    accelerations: tuple[Twist, ...] = ()
    time_from_start: Duration = Duration()


class MultiDOFJointTrajectory(msgspec.Struct, frozen=True):
    """Points that planar and floating joints pass; not supported. Source: trajectory_msgs."""

    ros_type: ClassVar[str] = "trajectory_msgs/msg/MultiDOFJointTrajectory"

    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    points: tuple[MultiDOFJointTrajectoryPoint, ...] = ()


class JointTolerance(msgspec.Struct, frozen=True):
    """Allowed errors of a joint. Source: control_msgs/msg/JointTolerance.

    0 = as the controller has it, -1 = any, else the greatest error [rad or m] and its derivatives.
    """

    ros_type: ClassVar[str] = "control_msgs/msg/JointTolerance"

    name: str = ""
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class JointComponentTolerance(msgspec.Struct, frozen=True):
    """Allowed errors of a planar or floating joint. Source: control_msgs."""

    ros_type: ClassVar[str] = "control_msgs/msg/JointComponentTolerance"

    joint_name: str = ""
    component: UInt16 = 0
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class TrajectoryGoal(msgspec.Struct, frozen=True):
    """A trajectory and its tolerances."""

    ros_type: ClassVar[str] = "control_msgs/action/FollowJointTrajectory_Goal"

    trajectory: JointTrajectory = JointTrajectory()
    multi_dof_trajectory: MultiDOFJointTrajectory = MultiDOFJointTrajectory()
    path_tolerance: tuple[JointTolerance, ...] = ()
    component_path_tolerance: tuple[JointComponentTolerance, ...] = ()
    goal_tolerance: tuple[JointTolerance, ...] = ()
    component_goal_tolerance: tuple[JointComponentTolerance, ...] = ()
    goal_time_tolerance: Duration = Duration()


class SendTrajectoryRequest(msgspec.Struct, frozen=True):
    """Start a goal."""

    ros_type: ClassVar[str] = "control_msgs/action/FollowJointTrajectory_SendGoal_Request"

    goal_id: GoalId = GoalId()
    goal: TrajectoryGoal = TrajectoryGoal()


class SendTrajectoryResponse(msgspec.Struct, frozen=True):
    """Whether the goal is accepted."""

    ros_type: ClassVar[str] = "control_msgs/action/FollowJointTrajectory_SendGoal_Response"

    accepted: bool = False
    stamp: Time = Time()


class TrajectoryResult(msgspec.Struct, frozen=True):
    """Result of a goal."""

    ros_type: ClassVar[str] = "control_msgs/action/FollowJointTrajectory_Result"

    error_code: Int32 = 0
    """See `TrajectoryCode`."""
    error_string: str = ""


class GetTrajectoryResultRequest(msgspec.Struct, frozen=True):
    """Wait for the end of a goal."""

    ros_type: ClassVar[str] = "control_msgs/action/FollowJointTrajectory_GetResult_Request"

    goal_id: GoalId = GoalId()


class GetTrajectoryResultResponse(msgspec.Struct, frozen=True):
    """Sent at the end of the goal."""

    ros_type: ClassVar[str] = "control_msgs/action/FollowJointTrajectory_GetResult_Response"

    status: Int8 = 0
    result: TrajectoryResult = TrajectoryResult()


class TrajectoryFeedback(msgspec.Struct, frozen=True):
    """Where joints should be, are, and the difference; as in humble and jazzy."""

    ros_type: ClassVar[str] = "control_msgs/action/FollowJointTrajectory_Feedback"

    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    desired: JointTrajectoryPoint = JointTrajectoryPoint()
    actual: JointTrajectoryPoint = JointTrajectoryPoint()
    error: JointTrajectoryPoint = JointTrajectoryPoint()
    multi_dof_joint_names: tuple[str, ...] = ()
    multi_dof_desired: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()
    multi_dof_actual: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()
    multi_dof_error: MultiDOFJointTrajectoryPoint = MultiDOFJointTrajectoryPoint()


class TrajectoryFeedbackMessage(msgspec.Struct, frozen=True):
    """Feedback with the id of its goal."""

    ros_type: ClassVar[str] = "control_msgs/action/FollowJointTrajectory_FeedbackMessage"

    goal_id: GoalId = GoalId()
    feedback: TrajectoryFeedback = TrajectoryFeedback()


FOLLOW_JOINT_TRAJECTORY: Final = ActionKind(
    "control_msgs/action/FollowJointTrajectory",
    (SendTrajectoryRequest, SendTrajectoryResponse),
    (GetTrajectoryResultRequest, GetTrajectoryResultResponse),
    TrajectoryFeedbackMessage,
)
