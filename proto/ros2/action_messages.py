"""Messages of actions, and those that rosidl generates for the action SimulateSteps."""

from enum import IntEnum
from typing import Annotated, ClassVar, Final, TypeAlias

import msgspec
from msgspec import Meta

from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import Int8, UInt8, UInt64
from zensim.proto.messages.standard_messages import Time

ACTION_NAME: Final = "simulate_steps"
NO_GOAL_ID: Final = (0,) * 16
Bytes16 = Annotated[
    tuple[UInt8, ...], Meta(min_length=16, max_length=16, extra={"cdr": "B", "length": 16})
]


class GoalStatusCode(IntEnum):
    """States of a goal. Source: action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


class CancelCode(IntEnum):
    """Results of a cancel request. Source: action_msgs/srv/CancelGoal."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


class GoalId(msgspec.Struct, frozen=True):
    """Id of a goal. Source: unique_identifier_msgs/msg/UUID."""

    ros_type: ClassVar[str] = "unique_identifier_msgs/msg/UUID"

    uuid: Bytes16 = NO_GOAL_ID


class GoalInfo(msgspec.Struct, frozen=True):
    """Id of a goal and the time of its acceptance. Source: action_msgs/msg/GoalInfo."""

    ros_type: ClassVar[str] = "action_msgs/msg/GoalInfo"

    goal_id: GoalId = GoalId()
    stamp: Time = Time()


class GoalStatusMessage(msgspec.Struct, frozen=True):
    """State of a goal. Source: action_msgs/msg/GoalStatus."""

    ros_type: ClassVar[str] = "action_msgs/msg/GoalStatus"

    goal_info: GoalInfo = GoalInfo()
    status: Int8 = 0


class GoalStatusArray(msgspec.Struct, frozen=True):
    """States of all goals. Source: action_msgs/msg/GoalStatusArray."""

    ros_type: ClassVar[str] = "action_msgs/msg/GoalStatusArray"

    status_list: tuple[GoalStatusMessage, ...] = ()


class StepsGoal(msgspec.Struct, frozen=True):
    """Number of steps."""

    ros_type: ClassVar[str] = "simulation_interfaces/action/SimulateSteps_Goal"

    steps: UInt64 = 0


class SendGoalRequest(msgspec.Struct, frozen=True):
    """Start a goal."""

    ros_type: ClassVar[str] = "simulation_interfaces/action/SimulateSteps_SendGoal_Request"

    goal_id: GoalId = GoalId()
    goal: StepsGoal = StepsGoal()


class SendGoalResponse(msgspec.Struct, frozen=True):
    """Whether the goal is accepted."""

    ros_type: ClassVar[str] = "simulation_interfaces/action/SimulateSteps_SendGoal_Response"

    accepted: bool = False
    stamp: Time = Time()


class StepsResult(msgspec.Struct, frozen=True):
    """Result of a goal."""

    ros_type: ClassVar[str] = "simulation_interfaces/action/SimulateSteps_Result"

    result: Result = Result()


class GetResultRequest(msgspec.Struct, frozen=True):
    """Wait for the end of a goal."""

    ros_type: ClassVar[str] = "simulation_interfaces/action/SimulateSteps_GetResult_Request"

    goal_id: GoalId = GoalId()


class GetResultResponse(msgspec.Struct, frozen=True):
    """Sent at the end of the goal."""

    ros_type: ClassVar[str] = "simulation_interfaces/action/SimulateSteps_GetResult_Response"

    status: Int8 = 0
    result: StepsResult = StepsResult()


class StepsFeedback(msgspec.Struct, frozen=True):
    """Completed and remaining steps."""

    ros_type: ClassVar[str] = "simulation_interfaces/action/SimulateSteps_Feedback"

    completed_steps: UInt64 = 0
    remaining_steps: UInt64 = 0


class FeedbackMessage(msgspec.Struct, frozen=True):
    """Feedback with the id of its goal."""

    ros_type: ClassVar[str] = "simulation_interfaces/action/SimulateSteps_FeedbackMessage"

    goal_id: GoalId = GoalId()
    feedback: StepsFeedback = StepsFeedback()


class CancelGoalRequest(msgspec.Struct, frozen=True):
    """Cancel a goal; all goals if there is no id. Source: action_msgs/srv/CancelGoal."""

    ros_type: ClassVar[str] = "action_msgs/srv/CancelGoal_Request"

    goal_info: GoalInfo = GoalInfo()


class CancelGoalResponse(msgspec.Struct, frozen=True):
    """Canceled goals. Source: action_msgs/srv/CancelGoal."""

    ros_type: ClassVar[str] = "action_msgs/srv/CancelGoal_Response"

    return_code: Int8 = 0
    goals_canceling: tuple[GoalInfo, ...] = ()


ServiceTypes: TypeAlias = tuple[type[msgspec.Struct], type[msgspec.Struct]]
"""Types of request and response."""


class ActionKind(msgspec.Struct, frozen=True):
    """The messages that rosidl generates for an action."""

    ros_type: str
    """`pkg/action/Name`."""
    send_goal: ServiceTypes
    get_result: ServiceTypes
    feedback: type[msgspec.Struct]

    def list_services(self, name: str) -> dict[str, ServiceTypes]:
        """List requests and responses of an action by the names of its services."""
        root = f"/{name}/_action"
        return {
            f"{root}/send_goal": self.send_goal,
            f"{root}/cancel_goal": (CancelGoalRequest, CancelGoalResponse),
            f"{root}/get_result": self.get_result,
        }

    def list_topics(self, name: str) -> dict[str, type[msgspec.Struct]]:
        """List the messages of an action by the names of its topics: feedback, then status."""
        root = f"/{name}/_action"
        return {f"{root}/feedback": self.feedback, f"{root}/status": GoalStatusArray}


SIMULATE_STEPS_ACTION: Final = ActionKind(
    "simulation_interfaces/action/SimulateSteps",
    (SendGoalRequest, SendGoalResponse),
    (GetResultRequest, GetResultResponse),
    FeedbackMessage,
)
ACTION_SERVICES: Final = SIMULATE_STEPS_ACTION.list_services(ACTION_NAME)
"""Requests and responses of SimulateSteps by name."""
ACTION_TOPICS: Final = SIMULATE_STEPS_ACTION.list_topics(ACTION_NAME)
"""Messages of the topics of SimulateSteps by name."""
