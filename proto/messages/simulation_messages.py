"""Services that control the simulation: state, steps, speed, reset, features."""

from enum import IntEnum
from typing import ClassVar, Literal

import msgspec

from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt8, UInt16, UInt64
from zensim.proto.messages.standard_messages import Time

MAX_GOAL_ID_LENGTH = 64
"""Characters of a goal's id."""

StepsGoalStatus = Literal["executing", "succeeded", "canceled", "aborted"]


class SimulateStepsRequest(msgspec.Struct, frozen=True):
    """Advance a paused world by so many steps, with progress.

    The same id and steps again join the goal, or fetch the result of one that is over.
    Source: simulation_interfaces/action/SimulateSteps.
    """

    ros_type: ClassVar[str] = "zensim/srv/SimulateSteps_Request"

    steps: UInt64 = 1
    goal_id: str = ""
    """At most `MAX_GOAL_ID_LENGTH` printable characters; without one there is no progress to hear."""


class SimulateStepsResponse(msgspec.Struct, frozen=True):
    """Sent when the goal is over: all steps are made, or it was canceled or aborted."""

    ros_type: ClassVar[str] = "zensim/srv/SimulateSteps_Response"

    result: Result = Result()
    goal_id: str = ""
    status: StepsGoalStatus = "succeeded"
    completed_steps: UInt64 = 0
    remaining_steps: UInt64 = 0


class StepsProgress(msgspec.Struct, frozen=True):
    """How far a goal is; at most 10 times a second of wall time, and when it is over."""

    ros_type: ClassVar[str] = "zensim/msg/StepsProgress"

    goal_id: str
    completed_steps: UInt64
    remaining_steps: UInt64
    status: StepsGoalStatus = "executing"


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


class State(IntEnum):
    """What the simulation does. Source: simulation_interfaces/msg/SimulationState."""

    STOPPED = 0
    PLAYING = 1
    PAUSED = 2
    QUITTING = 3
    NO_WORLD = 4
    LOADING_WORLD = 5


class SimulationState(msgspec.Struct, frozen=True):
    """One of `State`. Source: simulation_interfaces/msg/SimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SimulationState"

    state: UInt8 = State.STOPPED


class GetSimulationStateRequest(msgspec.Struct, frozen=True):
    """Ask whether it plays. Source: simulation_interfaces/srv/GetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulationState_Request"


class GetSimulationStateResponse(msgspec.Struct, frozen=True):
    """The state. Source: simulation_interfaces/srv/GetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulationState_Response"

    state: SimulationState = SimulationState()
    result: Result = Result()


class SetSimulationStateRequest(msgspec.Struct, frozen=True):
    """Play or pause. Source: simulation_interfaces/srv/SetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetSimulationState_Request"

    state: SimulationState = SimulationState()


class SetSimulationStateResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/SetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetSimulationState_Response"

    result: Result = Result()


class StepSimulationRequest(msgspec.Struct, frozen=True):
    """Advance a paused world by so many steps. Source: simulation_interfaces/srv/StepSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/StepSimulation_Request"

    steps: UInt64 = 1


class StepSimulationResponse(msgspec.Struct, frozen=True):
    """Sent when the last step is done. Source: simulation_interfaces/srv/StepSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/StepSimulation_Response"

    result: Result = Result()


class ResetScope(IntEnum):
    """What a reset touches, as bits. Source: simulation_interfaces/srv/ResetSimulation."""

    DEFAULT = 0
    TIME = 1
    STATE = 2
    SPAWNED = 4
    ALL = 255


class ResetSimulationRequest(msgspec.Struct, frozen=True):
    """Go back to the start. Source: simulation_interfaces/srv/ResetSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/ResetSimulation_Request"

    scope: UInt8 = ResetScope.DEFAULT


class ResetSimulationResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/ResetSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/ResetSimulation_Response"

    result: Result = Result()


class Feature(IntEnum):
    """What this simulator can do. Source: simulation_interfaces/msg/SimulatorFeatures."""

    SPAWNING = 0
    DELETING = 1
    NAMED_POSES = 2
    POSE_BOUNDS = 3
    ENTITY_TAGS = 4
    ENTITY_BOUNDS = 5
    ENTITY_BOUNDS_BOX = 6
    ENTITY_BOUNDS_CONVEX = 7
    ENTITY_CATEGORIES = 8
    SPAWNING_RESOURCE_STRING = 9
    ENTITY_STATE_GETTING = 10
    ENTITY_STATE_SETTING = 11
    ENTITY_INFO_GETTING = 12
    ENTITY_INFO_SETTING = 13
    SPAWNABLES = 14
    SIMULATION_RESET = 20
    SIMULATION_RESET_TIME = 21
    SIMULATION_RESET_STATE = 22
    SIMULATION_RESET_SPAWNED = 23
    SIMULATION_STATE_GETTING = 24
    SIMULATION_STATE_SETTING = 25
    SIMULATION_STATE_PAUSE = 26
    STEP_SIMULATION_SINGLE = 31
    STEP_SIMULATION_MULTIPLE = 32
    STEP_SIMULATION_ACTION = 33
    WORLD_LOADING = 40
    WORLD_RESOURCE_STRING = 41
    WORLD_TAGS = 42
    WORLD_UNLOADING = 43
    WORLD_INFO_GETTING = 44
    AVAILABLE_WORLDS = 45
    SPAWNING_ENTITIES = 50


class SimulatorFeatures(msgspec.Struct, frozen=True):
    """Features and spawn formats. Source: simulation_interfaces/msg/SimulatorFeatures."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SimulatorFeatures"

    features: tuple[UInt16, ...] = ()
    spawn_formats: tuple[str, ...] = ()
    custom_info: str = ""


class GetSimulatorFeaturesRequest(msgspec.Struct, frozen=True):
    """Ask what it can do. Source: simulation_interfaces/srv/GetSimulatorFeatures."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulatorFeatures_Request"


class GetSimulatorFeaturesResponse(msgspec.Struct, frozen=True):
    """The features. Source: simulation_interfaces/srv/GetSimulatorFeatures."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulatorFeatures_Response"

    features: SimulatorFeatures = SimulatorFeatures()
