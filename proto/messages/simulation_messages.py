"""Services that control the simulation: state, steps, speed, reset, features."""

from enum import IntEnum
from typing import ClassVar, Literal

import msgspec

from zensim.proto.messages.agent_messages import TwistCommands
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt8, UInt16, UInt32, UInt64
from zensim.proto.messages.standard_messages import Time
from zensim.proto.messages.telemetry_messages import Snapshot

MAX_GOAL_ID_LENGTH = 64
"""Maximum length of a goal id."""

StepsGoalStatus = Literal["executing", "succeeded", "canceled", "aborted"]


class SimulateStepsRequest(msgspec.Struct, frozen=True):
    """Advance a paused world by a number of steps, with progress.

    A request with the id and steps of a goal attaches to it, or returns its result if it is over.
    Source: simulation_interfaces/action/SimulateSteps.
    """

    ros_type: ClassVar[str] = "zensim/srv/SimulateSteps_Request"

    steps: UInt64 = 1
    goal_id: str = ""
    """Id of `MAX_GOAL_ID_LENGTH` printable characters at most; progress needs an id."""
    client: str = ""
    """Name of a token `sim/<world>/alive/clients/<client>`: while it exists, no other client steps;
    empty = no lease."""
    twists: TwistCommands | None = None
    """Orders that count from the first of these steps on."""
    wants_snapshot: bool = False
    """Whether the response has the state after the last step."""
    is_eager: bool = False
    """Whether the response is sent before the agents have answered the last state; they must have
    before the next step. Their telemetry of that state may come after the response."""


class SimulateStepsResponse(msgspec.Struct, frozen=True):
    """Sent when the goal has succeeded, or was canceled or aborted."""

    ros_type: ClassVar[str] = "zensim/srv/SimulateSteps_Response"

    result: Result = Result()
    goal_id: str = ""
    status: StepsGoalStatus = "succeeded"
    completed_steps: UInt64 = 0
    remaining_steps: UInt64 = 0
    snapshot: Snapshot | None = None


class StepsProgress(msgspec.Struct, frozen=True):
    """Progress of a goal, at most at 10 Hz of wall time, and at its end."""

    ros_type: ClassVar[str] = "zensim/msg/StepsProgress"

    goal_id: str
    completed_steps: UInt64
    remaining_steps: UInt64
    status: StepsGoalStatus = "executing"


class JoinLockstepRequest(msgspec.Struct, frozen=True):
    """Finish a control step as a client that is awaited like an agent, and wait for the next one.

    With the first request a client joins; it leaves when its liveliness token disappears.
    """

    ros_type: ClassVar[str] = "zensim/srv/JoinLockstep_Request"

    client: str = ""
    """Name of a token `sim/<world>/alive/clients/<client>`."""
    steps: UInt32 = 0
    """Steps between two control steps of the client; 0 = each control step."""
    epoch: UInt32 = 0
    """Epoch of the control step that is finished; so is `step`."""
    step: UInt64 = 0
    twists: TwistCommands | None = None
    """Orders that act in the next control step."""


class JoinLockstepResponse(msgspec.Struct, frozen=True):
    """Sent at the next control step of the client."""

    ros_type: ClassVar[str] = "zensim/srv/JoinLockstep_Response"

    result: Result = Result()
    snapshot: Snapshot | None = None


class CancelStepsRequest(msgspec.Struct, frozen=True):
    """Cancel a goal; all goals if there is no id."""

    ros_type: ClassVar[str] = "zensim/srv/CancelSteps_Request"

    goal_id: str = ""


class CancelStepsResponse(msgspec.Struct, frozen=True):
    """Canceled goals."""

    ros_type: ClassVar[str] = "zensim/srv/CancelSteps_Response"

    result: Result = Result()
    goal_ids: tuple[str, ...] = ()


class RunToRequest(msgspec.Struct, frozen=True):
    """Advance a paused world to the first step at or after a simulation time."""

    ros_type: ClassVar[str] = "zensim/srv/RunTo_Request"

    time: Time = Time()


class RunToResponse(msgspec.Struct, frozen=True):
    """Sent at that step."""

    ros_type: ClassVar[str] = "zensim/srv/RunTo_Response"

    result: Result = Result()
    time: Time = Time()
    """Simulation time of the last step."""
    completed_steps: UInt64 = 0


class SetSpeedRequest(msgspec.Struct, frozen=True):
    """Set the target real-time factor."""

    ros_type: ClassVar[str] = "zensim/srv/SetSpeed_Request"

    real_time_factor: float = 1.0
    """0 = unlimited, else 0.01 to 1000."""


class SetSpeedResponse(msgspec.Struct, frozen=True):
    """Result of the request."""

    ros_type: ClassVar[str] = "zensim/srv/SetSpeed_Response"

    result: Result = Result()


class State(IntEnum):
    """States of the simulation. Source: simulation_interfaces/msg/SimulationState."""

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
    """Get the state of the simulation. Source: simulation_interfaces/srv/GetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulationState_Request"


class GetSimulationStateResponse(msgspec.Struct, frozen=True):
    """State of the simulation. Source: simulation_interfaces/srv/GetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulationState_Response"

    state: SimulationState = SimulationState()
    result: Result = Result()


class SetSimulationStateRequest(msgspec.Struct, frozen=True):
    """Play or pause. Source: simulation_interfaces/srv/SetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetSimulationState_Request"

    state: SimulationState = SimulationState()


class SetSimulationStateResponse(msgspec.Struct, frozen=True):
    """Result of the request. Source: simulation_interfaces/srv/SetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetSimulationState_Response"

    result: Result = Result()


class StepSimulationRequest(msgspec.Struct, frozen=True):
    """Advance a paused world by some steps. Source: simulation_interfaces/srv/StepSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/StepSimulation_Request"

    steps: UInt64 = 1


class StepSimulationResponse(msgspec.Struct, frozen=True):
    """Sent after the last step. Source: simulation_interfaces/srv/StepSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/StepSimulation_Response"

    result: Result = Result()


class ResetScope(IntEnum):
    """Parts to reset, as bits. Source: simulation_interfaces/srv/ResetSimulation."""

    DEFAULT = 0
    TIME = 1
    STATE = 2
    SPAWNED = 4
    ALL = 255


class ResetSimulationRequest(msgspec.Struct, frozen=True):
    """Reset the simulation. Source: simulation_interfaces/srv/ResetSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/ResetSimulation_Request"

    scope: UInt8 = ResetScope.DEFAULT


class ResetSimulationResponse(msgspec.Struct, frozen=True):
    """Result of the request. Source: simulation_interfaces/srv/ResetSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/ResetSimulation_Response"

    result: Result = Result()


class Feature(IntEnum):
    """Supported features. Source: simulation_interfaces/msg/SimulatorFeatures."""

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
    """List the supported features. Source: simulation_interfaces/srv/GetSimulatorFeatures."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulatorFeatures_Request"


class GetSimulatorFeaturesResponse(msgspec.Struct, frozen=True):
    """Supported features. Source: simulation_interfaces/srv/GetSimulatorFeatures."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulatorFeatures_Response"

    features: SimulatorFeatures = SimulatorFeatures()
