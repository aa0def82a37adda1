"""Time as it is asked for: goals of steps, runs to a time, speed. zensim's own.

`simulate_steps`, `cancel_steps` and the progress topic are the action
simulation_interfaces/action/SimulateSteps on plain keys: the goal's id is its caller's to choose.
"""

from typing import ClassVar, Literal

import msgspec

from zensim.proto.header import Time
from zensim.proto.result import Result
from zensim.proto.widths import UInt64

MAX_GOAL_ID = 64
"""Characters of a goal's id."""

GoalStatus = Literal["executing", "succeeded", "canceled", "aborted"]


class SimulateStepsRequest(msgspec.Struct, frozen=True):
    """Advance a paused world by so many steps, with progress.

    The same id and steps again join the goal, or fetch the result of one that is over.
    Source: simulation_interfaces/action/SimulateSteps.
    """

    ros_type: ClassVar[str] = "zensim/srv/SimulateSteps_Request"

    steps: UInt64 = 1
    goal_id: str = ""
    """At most `MAX_GOAL_ID` printable characters; without one there is no progress to hear."""


class SimulateStepsResponse(msgspec.Struct, frozen=True):
    """Sent when the goal is over: all steps are made, or it was canceled or aborted."""

    ros_type: ClassVar[str] = "zensim/srv/SimulateSteps_Response"

    result: Result = Result()
    goal_id: str = ""
    status: GoalStatus = "succeeded"
    completed_steps: UInt64 = 0
    remaining_steps: UInt64 = 0


class StepsProgress(msgspec.Struct, frozen=True):
    """How far a goal is; at most 10 times a second of wall time, and when it is over."""

    ros_type: ClassVar[str] = "zensim/msg/StepsProgress"

    goal_id: str
    completed_steps: UInt64
    remaining_steps: UInt64
    status: GoalStatus = "executing"


class CancelStepsRequest(msgspec.Struct, frozen=True):
    """End a goal before its last step; without an id, all goals."""

    ros_type: ClassVar[str] = "zensim/srv/CancelSteps_Request"

    goal_id: str = ""


class CancelStepsResponse(msgspec.Struct, frozen=True):
    """Which goals were ended."""

    ros_type: ClassVar[str] = "zensim/srv/CancelSteps_Response"

    result: Result = Result()
    goal_ids: tuple[str, ...] = ()


class RunToRequest(msgspec.Struct, frozen=True):
    """Advance a paused world to the first step at or after a simulation time."""

    ros_type: ClassVar[str] = "zensim/srv/RunTo_Request"

    time: Time = Time()


class RunToResponse(msgspec.Struct, frozen=True):
    """Sent when the time is reached."""

    ros_type: ClassVar[str] = "zensim/srv/RunTo_Response"

    result: Result = Result()
    time: Time = Time()
    """Of the step where it stopped."""
    completed_steps: UInt64 = 0


class SetSpeedRequest(msgspec.Struct, frozen=True):
    """Choose the real-time factor to hold from now on."""

    ros_type: ClassVar[str] = "zensim/srv/SetSpeed_Request"

    real_time_factor: float = 1.0
    """0 = as fast as it can, else 0.01 to 1000."""


class SetSpeedResponse(msgspec.Struct, frozen=True):
    """How it went."""

    ros_type: ClassVar[str] = "zensim/srv/SetSpeed_Response"

    result: Result = Result()
